/* Lengths of wrapped paths and their slopes, by points and by places of surfaces.
 *
 * Of a path `at` has three numbers a point, then a rotation row by row and an origin a surface, in
 * common axes. What is found: the length, the change of it with every point, and with every
 * surface, moved and turned about its origin.
 */

/* One end of a straight line that a surface holds. */
static void add_pull(const double *origin, const double *point, const double *e, double sign,
                     double *by_wrap) {
  double arm[3] = {point[0] - origin[0], point[1] - origin[1], point[2] - origin[2]}, turn[3];
  cross3(arm, e, turn);
  for (int i = 0; i < 3; i++) {
    by_wrap[i] += sign * e[i];
    by_wrap[3 + i] += sign * turn[i];
  }
}

/* A line between two points, over what it wraps. */
static double add_line(const Router *r, const Solved *on, int line, double *by_points,
                       double *by_wraps) {
  const double *begin = r->points + 3 * line;
  double length = 0.0;
  int count = on ? on->count : 0;
  for (int i = 0; i <= count; i++) {
    const double *end = i < count ? on->ends[i][0] : r->points + 3 * (line + 1);
    Line straight;
    for (int k = 0; k < 3; k++) straight.direction[k] = end[k] - begin[k];
    straight.length = unit3(straight.direction, straight.direction);
    const double *e = straight.direction;
    length += straight.length + (i < count ? on->arcs[i].length : 0.0);
    if (i) {
      int w = on->wraps[i - 1];
      add_pull(r->places[w].place + 9, begin, e, -1.0, by_wraps + 6 * w);
    }
    if (i < count) {
      int w = on->wraps[i];
      add_pull(r->places[w].place + 9, end, e, 1.0, by_wraps + 6 * w);
      begin = on->ends[i][1];
    }
    for (int k = 0; k < 3; k++) {
      if (!i) by_points[3 * line + k] -= e[k];
      if (i == count) by_points[3 * line + 3 + k] += e[k];
    }
  }
  return length;
}

/* One path; whether it is found. */
static int find_path(const Surface *surfaces, const WrapPath *path, const WrapReach *reaches,
                     const double *at, double *out) {
  Router r;
  Held held;
  double *by_points = out + 1, *by_wraps = by_points + 3 * path->points;
  r.path = path;
  r.reaches = reaches;
  r.points = at;
  r.count = 0;
  for (int w = 0; w < path->wraps; w++) {
    r.places[w].surface = surfaces + reaches[w].surface;
    memcpy(r.places[w].place, at + 3 * path->points + 12 * w, 12 * sizeof *at);
  }
  if (!settle_route(&r, &held)) return 0;
  memset(out, 0, (1 + 3 * path->points + 6 * path->wraps) * sizeof *out);
  for (int line = 0; line < path->points - 1; line++) {
    const Solved *on = held.count[line] ? geodesics_of(&r, &held, line) : 0;
    *out += add_line(&r, on, line, by_points, by_wraps);
  }
  return 1;
}

/* One path or none: what is not found has no number. */
static void find_or_leave(const Surface *surfaces, const WrapPath *path, const WrapReach *reaches,
                          const double *at, double *out) {
  if (find_path(surfaces, path, reaches, at, out)) return;
  for (int k = 0; k < 1 + 3 * path->points + 6 * path->wraps; k++) out[k] = NAN;
}
