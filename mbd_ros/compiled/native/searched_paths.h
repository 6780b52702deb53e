/* The paths of a scene, before its functions are evaluated: tables stand before this file. */

static void find_paths(const double *at, double *out) {
  for (int i = 0; i < WRAP_PATHS; i++) {
    const WrapPath *path = wrap_paths + i;
    find_or_leave(wrap_surfaces, path, wrap_reaches + path->first, at, out);
    at += 3 * path->points + 12 * path->wraps;
    out += 1 + 3 * path->points + 6 * path->wraps;
  }
}

static int are_found(const double *paths) {
  for (int i = 0; i < WRAP_NUMBERS; i++)
    if (paths[i] != paths[i]) return 0;
  return 1;
}

/* What functions of the scene ask for at a state. */
static void search_paths(const double *t, const double *q, const double *p, double *out,
                         double *work) {
  double at[WRAP_PLACES];
  path_places(t, q, p, at, work);
  find_paths(at, out);
}

EXPORT void call_search_paths(void *const *at) { search_paths(at[0], at[1], at[2], at[3], at[4]); }
