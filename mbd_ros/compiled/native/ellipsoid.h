/* Wraps over an ellipsoid; geodesics by Taylor series.
 *
 * x'' = -(t . S t) n and y'' = -K y have right sides made of products and quotients of series, so
 * that coefficients of any order follow one after the other, and the last ones say how long a step
 * may be. Source: R. E. Moore, Interval Analysis, 1966, ch. 11; A. Jorba, M. Zou, A software
 * package for the numerical integration of ODEs by means of high-order Taylor methods, Exp. Math.
 * 14, 2005, 99.
 */
#define TERMS 18
#define STEPS_OF_GEODESIC 200

typedef struct {
  double x[3][TERMS + 2], t[3][TERMS + 2], y[2][TERMS + 2];
} Series;

static double convolve(int k, const double *a, const double *b) {
  double sum = 0.0;
  for (int j = 0; j <= k; j++) sum += a[j] * b[k - j];
  return sum;
}

/* The square of a series at order k. */
static double squared(int k, const double *a) {
  double sum = 0.0;
  for (int j = 0; 2 * j < k; j++) sum += a[j] * a[k - j];
  sum += sum;
  return k % 2 ? sum : sum + a[k / 2] * a[k / 2];
}

/* Series of a geodesic and of its Jacobi fields from x, t, y and their slopes. */
static void series_of(const double *h, Series *f) {
  double s[TERMS + 2], r[TERMS + 2], g[TERMS + 2], q[TERMS + 2];
  double product = h[0] * h[1] * h[2];
  for (int k = 0; k < TERMS; k++) {
    double u = 0.0;
    s[k] = 0.0;
    for (int i = 0; i < 3; i++) {
      u += h[i] * squared(k, f->t[i]);
      s[k] += h[i] * h[i] * squared(k, f->x[i]);
    }
    for (int j = 1; j <= k; j++) u -= s[j] * r[k - j];
    r[k] = u / s[0];
    q[k] = squared(k, s);
    double gauss = k ? 0.0 : product;
    for (int j = 1; j <= k; j++) gauss -= q[j] * g[k - j];
    g[k] = gauss / q[0];
    for (int i = 0; i < 3; i++) {
      f->t[i][k + 1] = -h[i] * convolve(k, r, f->x[i]) / (k + 1);
      f->x[i][k + 1] = f->t[i][k] / (k + 1);
    }
    for (int i = 0; i < 2; i++)
      f->y[i][k + 2 <= TERMS ? k + 2 : TERMS + 1] =
          -convolve(k, g, f->y[i]) / ((k + 1) * (k + 2));
  }
}

static double at_length(const double *c, double l) {
  double sum = c[TERMS];
  for (int k = TERMS - 1; k >= 0; k--) sum = sum * l + c[k];
  return sum;
}

static double slope_at(const double *c, double l) {
  double sum = TERMS * c[TERMS];
  for (int k = TERMS - 1; k >= 1; k--) sum = sum * l + k * c[k];
  return sum;
}

/* How far series hold to rounding. */
static double reach_of(const Series *f, double size) {
  double least = INFINITY;
  for (int k = TERMS - 1; k <= TERMS; k++) {
    double most = 0.0;
    for (int i = 0; i < 3; i++) most = fmax(most, fabs(f->x[i][k]));
    least = fmin(least, pow(1.0e-17 * size / (most > 0.0 ? most : 1.0e-300), 1.0 / k));
  }
  return least;
}

static int ellipsoid_flow(const Surface *s, Arc *arc, Flow *flow) {
  double h[3], left = arc->length, half = 0.5 * arc->length, way = left < 0.0 ? -1.0 : 1.0;
  Series f;
  double y[2][2] = {{1.0, 0.0}, {0.0, 1.0}}, x[3], t[3];
  for (int i = 0; i < 3; i++) h[i] = 1.0 / (s->a[i] * s->a[i]);
  memcpy(x, arc->start, sizeof x);
  memcpy(t, arc->direction, sizeof t);
  memcpy(arc->middle, x, sizeof x);
  for (int step = 0; step < STEPS_OF_GEODESIC; step++) {
    for (int i = 0; i < 3; i++) f.x[i][0] = x[i], f.t[i][0] = t[i];
    for (int i = 0; i < 2; i++) f.y[i][0] = y[i][0], f.y[i][1] = y[i][1];
    series_of(h, &f);
    double l = reach_of(&f, s->size);
    int is_last = !(l < fabs(left));
    l = is_last ? left : way * l;
    if (way * half >= 0.0 && way * (half - l) <= 0.0)
      for (int i = 0; i < 3; i++) arc->middle[i] = at_length(f.x[i], half);
    for (int i = 0; i < 3; i++) x[i] = at_length(f.x[i], l), t[i] = at_length(f.t[i], l);
    for (int i = 0; i < 2; i++) {
      double before[2] = {at_length(f.y[i], l), slope_at(f.y[i], l)};
      memcpy(y[i], before, sizeof before);
    }
    half -= l;
    left -= l;
    if (is_last) {
      Flow found = {{t[0], t[1], t[2]}, {y[0][0], y[0][1]}, {y[1][0], y[1][1]}};
      *flow = found;
      memcpy(arc->end, x, sizeof x);
      return 1;
    }
  }
  return 0;
}

/* The nearest point of the ellipsoid from inside. */
static void nearest_outside(const Surface *s, const double *inside, double *out) {
  double scaled[3], square[3], p[3], t = -INFINITY, size = s->size * s->size;
  for (int i = 0; i < 3; i++) {
    square[i] = s->a[i] * s->a[i];
    p[i] = (inside[i] < 0.0 ? -1.0 : 1.0) * fmax(fabs(inside[i]), 1.0e-9 * s->a[i]);
    scaled[i] = s->a[i] * p[i];
    t = fmax(t, fabs(scaled[i]) - square[i]);
  }
  for (int step = 0; step < 60; step++) {
    double excess = -1.0, slope = 0.0;
    for (int i = 0; i < 3; i++) {
      double share = scaled[i] / (t + square[i]);
      excess += share * share;
      slope += share * share / (t + square[i]);
    }
    t += excess / (2.0 * slope);
    if (!(fabs(excess / (2.0 * slope)) > 1.0e-15 * size)) break;
  }
  for (int i = 0; i < 3; i++) out[i] = square[i] * p[i] / (t + square[i]);
}

/* Where the tangent of a point touches a circle about the origin, and its direction. */
static void rim(const double *point, double rho, const double *aside, double *contact,
                double *ahead) {
  double out[3], off[3], distance = unit3(point, out);
  unit3(aside, off);
  double c = fmin(rho / (distance > 0.0 ? distance : 1.0), 1.0), sine = sqrt(1.0 - c * c);
  for (int i = 0; i < 3; i++) {
    contact[i] = c * out[i] - sine * off[i];
    ahead[i] = -sine * out[i] - c * off[i];
  }
}

static double section_length(const Surface *s, double rho, const double *first,
                             const double *ahead, double angle) {
  static const double x[8] = {0.0950125098376374, 0.2816035507792589, 0.4580167776572274,
                              0.6178762444026438, 0.755404408355003,  0.8656312023878318,
                              0.9445750230732326, 0.9894009349916499};
  static const double w[8] = {0.1894506104550685, 0.1826034150449236, 0.1691565193950025,
                              0.1495959888165767, 0.1246289712555339, 0.0951585116824928,
                              0.0622535239386479, 0.0271524594117541};
  double sum = 0.0;
  for (int k = 0; k < 16; k++) {
    double at = angle * (1.0 + (k < 8 ? x[k] : -x[k - 8])) / 2.0, c = cos(at), sine = sin(at);
    double speed[3];
    for (int i = 0; i < 3; i++) speed[i] = s->a[i] * (c * ahead[i] - sine * first[i]);
    sum += w[k % 8] * sqrt(dot3(speed, speed));
  }
  return rho * angle / 2.0 * sum;
}

static void ellipsoid_touch(const Surface *s, const double *a, const double *b, double sign,
                            Arc *arc) {
  double u[3], v[3], middle[3], top[3], normal[3], centre[3], to_u[3], to_v[3];
  double line[3], up[3], aside[3], first[3], last[3], ahead[3], other[3];
  for (int i = 0; i < 3; i++) u[i] = a[i] / s->a[i], v[i] = b[i] / s->a[i];
  crossing(u, v, 1.0, middle);
  for (int i = 0; i < 3; i++) middle[i] *= s->a[i];
  nearest_outside(s, middle, top);
  if (sign != 0.0) top[s->axis] = sign * fabs(top[s->axis]);
  for (int i = 0; i < 3; i++) line[i] = v[i] - u[i], up[i] = top[i] / s->a[i] - u[i];
  cross3(line, up, normal);
  unit3(normal, normal);
  double off = dot3(normal, u);
  for (int i = 0; i < 3; i++) {
    centre[i] = off * normal[i];
    to_u[i] = u[i] - centre[i];
    to_v[i] = v[i] - centre[i];
  }
  double rho = sqrt(fmax(1.0 - dot3(centre, centre), 0.0));
  cross3(normal, to_u, aside);
  rim(to_u, rho, aside, first, ahead);
  cross3(to_v, normal, aside);
  rim(to_v, rho, aside, last, other);
  cross3(last, first, other);
  double angle = remainder_of(atan2(dot3(other, normal), dot3(last, first)), 2.0 * M_PI);
  for (int i = 0; i < 3; i++) {
    arc->start[i] = s->a[i] * (centre[i] + rho * first[i]);
    arc->direction[i] = s->a[i] * ahead[i];
  }
  unit3(arc->direction, arc->direction);
  arc->length = section_length(s, rho, first, ahead, angle);
}
