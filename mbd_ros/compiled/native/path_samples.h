/* One path in many samples, with tables that are given. */
#include <stddef.h>

EXPORT void search_samples(const Surface *surfaces, const WrapPath *path, const WrapReach *reaches,
                           long samples, const double *at, double *out) {
  for (long i = 0; i < samples; i++) {
    find_or_leave(surfaces, path, reaches, at, out);
    at += 3 * path->points + 12 * path->wraps;
    out += 1 + 3 * path->points + 6 * path->wraps;
  }
}
