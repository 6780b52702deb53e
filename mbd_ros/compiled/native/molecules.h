/* Half steps of all molecules of a kind: the traced ones of LANES molecules, mapped.

   Arrays are [coordinates][lanes]; a last, shorter block repeats its last molecule. */
#include <string.h>

#ifndef COORDINATES
#error "the number of coordinates of a molecule is missing"
#endif

static void gather(const double *from, long lanes, long first, long count, real *to) {
  for (int k = 0; k < COORDINATES; ++k) {
    double *const out = (double *)(to + k);
    if (from == NULL) {
      for (long l = 0; l < LANES; ++l) out[l] = 0.0;
      continue;
    }
    memcpy(out, from + k * lanes + first, count * sizeof(double));
    for (long l = count; l < LANES; ++l) out[l] = out[count - 1];
  }
}

static void scatter(const real *from, long lanes, long first, long count, double *to) {
  for (int k = 0; k < COORDINATES; ++k)
    memcpy(to + k * lanes + first, (const double *)(from + k), count * sizeof(double));
}

static inline long least(long a, long b) { return a < b ? a : b; }

EXPORT void move_all(const double *x, double *v, const double *force, double kick, double h,
                     double *moved, long lanes) {
  real in[3][COORDINATES], out[2][COORDINATES], times[2], work[move_WORK + 1];
  for (long l = 0; l < LANES; ++l) ((double *)times)[l] = kick, ((double *)(times + 1))[l] = h;
  for (long first = 0; first < lanes; first += LANES) {
    const long count = least(LANES, lanes - first);
    gather(x, lanes, first, count, in[0]);
    gather(v, lanes, first, count, in[1]);
    gather(force, lanes, first, count, in[2]);
    move(in[0], in[1], in[2], times, out[0], out[1], work);
    scatter(out[0], lanes, first, count, moved);
    scatter(out[1], lanes, first, count, v);
  }
}

EXPORT void finish_all(const double *x, double *v, const double *force, double kick, long lanes) {
  real in[3][COORDINATES], out[COORDINATES], times[1], work[finish_WORK + 1];
  for (long l = 0; l < LANES; ++l) ((double *)times)[l] = kick;
  for (long first = 0; first < lanes; first += LANES) {
    const long count = least(LANES, lanes - first);
    gather(x, lanes, first, count, in[0]);
    gather(v, lanes, first, count, in[1]);
    gather(force, lanes, first, count, in[2]);
    finish(in[0], in[1], in[2], times, out, work);
    scatter(out, lanes, first, count, v);
  }
}
