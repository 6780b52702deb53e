/* Geodesics from their series, step by step. */

static eight at_length(int terms, const Series *f, double l) {
  eight sum = f->all[terms];
  for (int k = terms - 1; k >= 0; k--) sum = sum * l + f->all[k];
  return sum;
}

static double slope_at(int terms, const double *c, double l) {
  double sum = c[terms];
  for (int k = terms - 1; k >= 0; k--) sum = sum * l + c[k];
  return sum;
}

/* How far series hold, to rounding where all terms are taken. */
static double reach_of(const Series *f, int terms, double size) {
  double least = INFINITY, wanted = terms < TERMS ? 1.0e-6 * size : 1.0e-16 * size;
  for (int k = terms - 1; k <= terms; k++) {
    const eight last = f->all[k];
    double most = fmax(fmax(fabs(last[0]), fabs(last[1])), fmax(fabs(last[2]), 1.0e-300));
    least = fmin(least, exp(log(wanted / most) / k));
  }
  return least;
}

/* The end of a geodesic of an ellipsoid or a torus; whether it is reached. */
static int curved_flow(const Surface *s, int is_rough, Arc *arc, Flow *flow) {
  double h[3], left = arc->length, half = 0.5 * arc->length, way = left < 0.0 ? -1.0 : 1.0;
  int terms = is_rough ? ROUGH_TERMS : TERMS;
  const double *x = arc->start, *t = arc->direction;
  Series f;
  f.all[0] = (eight){x[0], x[1], x[2], 1.0, 0.0, t[0], t[1], t[2]};
  f.slopes[0][0] = 0.0;
  f.slopes[1][0] = 1.0;
  for (int i = 0; i < 3; i++) {
    h[i] = s->kind == TORUS ? 0.0 : 1.0 / (s->a[i] * s->a[i]);
    arc->middle[i] = x[i];
  }
  for (int step = 0; step < STEPS_OF_GEODESIC; step++) {
    if (s->kind == TORUS) torus_series(s, terms, &f);
    else series_of(h, terms, &f);
    double l = reach_of(&f, terms, s->size);
    int is_last = !(l < fabs(left));
    l = is_last ? left : way * l;
    if (way * half >= 0.0 && way * (half - l) <= 0.0) {
      const eight middle = at_length(terms, &f, half);
      for (int i = 0; i < 3; i++) arc->middle[i] = middle[i];
    }
    const eight end = at_length(terms, &f, l);
    for (int i = 0; i < 2; i++) f.slopes[i][0] = slope_at(terms, f.slopes[i], l);
    f.all[0] = end;
    half -= l;
    left -= l;
    if (is_last) {
      *flow = (Flow){{end[5], end[6], end[7]}, {end[3], f.slopes[0][0]}, {end[4], f.slopes[1][0]}};
      for (int i = 0; i < 3; i++) arc->end[i] = end[i];
      return 1;
    }
  }
  return 0;
}
