/* Which geodesic a search ends at, as core/kinematics/paths/wrapped_path.py decides. */

/* Whole length of a path over one surface. */
static double length_over(const double *a, const double *b, const Placed *one, const Arc *arc) {
  Line first, last;
  double begin[3], end[3];
  outwards(one->place, arc->start, begin);
  outwards(one->place, arc->end, end);
  line_between(a, begin, &first);
  line_between(end, b, &last);
  return first.length + arc->length + last.length;
}

/* Off the side that is asked for, or longer than the guess. */
static int is_astray(const double *a, const double *b, int count, const Placed *over,
                     const Arc *arcs, const Arc *guess, int checks_side) {
  const Surface *s = over->surface;
  for (int i = 0; checks_side && i < count; i++)
    if (over[i].surface->sign != 0.0 && over[i].surface->kind >= ELLIPSOID &&
        !on_side(over[i].surface, arcs[i].middle))
      return 1;
  if (count > 1 || s->kind != ELLIPSOID || s->sign != 0.0) return 0;
  return length_over(a, b, over, arcs) - length_over(a, b, over, guess) > 1.0e-9 * s->size;
}

/* From guesses on the nearer side, between what is on either side of a surface. */
static int plain_search(const double *a, const double *b, int count, const Placed *over,
                        Arc *arcs) {
  Arc starts[MOST_WRAPS];
  for (int i = 0; i < count; i++) {
    const Surface *s = over[i].surface;
    double begin[3], end[3], last[3], first[3];
    if (i) outwards(over[i - 1].place, arcs[i - 1].end, last);
    if (i + 1 < count) outwards(over[i + 1].place, arcs[i + 1].start, first);
    inwards(over[i].place, i ? last : a, begin);
    inwards(over[i].place, i + 1 < count ? first : b, end);
    if (s->kind == ELLIPSOID) ellipsoid_touch(s, begin, end, 0.0, starts + i);
    else touch_surface(s, begin, end, meets(s, begin, end), starts + i);
  }
  memcpy(arcs, starts, count * sizeof *arcs);
  return shortest(a, b, count, over, arcs);
}

/* From the great circle of a sphere that becomes the ellipsoid, ends stretched along. */
static int grown_search(const double *a, const double *b, const Placed *over, Arc *arc) {
  const Surface *goal = over->surface;
  Surface now = *goal;
  Placed here = {&now, {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0}};
  double begin[3], end[3], from[3], to[3], size = cbrt(goal->a[0] * goal->a[1] * goal->a[2]);
  inwards(over->place, a, begin);
  inwards(over->place, b, end);
  for (int i = 0; i < 3; i++) {
    now.a[i] = size;
    begin[i] /= goal->a[i];
    end[i] /= goal->a[i];
    from[i] = begin[i] * size;
    to[i] = end[i] * size;
  }
  now.size = size;
  ellipsoid_touch(&now, from, to, 0.0, arc);
  for (int step = 1; step <= 24; step++) {
    now.size = 0.0;
    for (int i = 0; i < 3; i++) {
      double axis = size * pow(goal->a[i] / size, step / 24.0);
      arc->start[i] *= axis / now.a[i];
      arc->direction[i] *= axis / now.a[i];
      now.a[i] = axis;
      now.size = fmax(now.size, axis);
      from[i] = begin[i] * axis;
      to[i] = end[i] * axis;
    }
    arc->length *= unit3(arc->direction, arc->direction);
    if (!shortest(from, to, 1, &here, arc)) return 0;
  }
  return 1;
}

/* Geodesics from a guess, which is tried otherwise where it leads astray; whether there are any. */
static int solved(const double *a, const double *b, int count, const Placed *over, Arc *arcs) {
  Arc guess[MOST_WRAPS], again[MOST_WRAPS];
  memcpy(guess, arcs, count * sizeof *arcs);
  int found = shortest(a, b, count, over, arcs);
  for (int retry = 0; retry < 2; retry++) {
    if (found && !is_astray(a, b, count, over, arcs, guess, !retry)) continue;
    memcpy(again, guess, count * sizeof *arcs);
    int better = retry ? count == 1 && over->surface->kind == ELLIPSOID &&
                             grown_search(a, b, over, again)
                       : plain_search(a, b, count, over, again);
    if (better) memcpy(arcs, again, count * sizeof *arcs);
    found |= better;
  }
  return found;
}
