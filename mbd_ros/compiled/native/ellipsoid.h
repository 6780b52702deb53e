/* Wraps over an ellipsoid; geodesics by Taylor series.
 *
 * x'' = -(t . S t) n and y'' = -K y have right sides made of products and quotients of series, so
 * that coefficients of any order follow one after the other, and the last ones say how long a step
 * may be. Source: R. E. Moore, Interval Analysis, 1966, ch. 11; A. Jorba, M. Zou, A software
 * package for the numerical integration of ODEs by means of high-order Taylor methods, Exp. Math.
 * 14, 2005, 99.
 */
#define TERMS 18
#define ROUGH_TERMS 10  /* far from the solution */
#define STEPS_OF_GEODESIC 200

typedef double eight __attribute__((vector_size(64)));

/* Coefficients: x in the first three places, two fields y in the next, x' = t in the last; y'. */
typedef struct {
  eight all[TERMS + 1];
  double slopes[2][TERMS + 1];
} Series;

/* Coefficient k of products, place by place, from a first term on. */
static inline eight product(int k, int first, const eight *a, const eight *b) {
  eight even = {0.0}, odd = {0.0};
  int j = first;
  for (; j < k; j += 2) {
    even += a[j] * b[k - j];
    odd += a[j + 1] * b[k - j - 1];
  }
  if (j == k) even += a[k] * b[0];
  return even + odd;
}

/* The same of squares. */
static inline eight squared(int k, const eight *a) {
  eight sum = {0.0};
  for (int j = 0; 2 * j < k; j++) sum += a[j] * a[k - j];
  sum += sum;
  if (k % 2 == 0) sum += a[k / 2] * a[k / 2];
  return sum;
}

/* Series of a geodesic and of its Jacobi fields from x, t, y and their slopes. With s = |H x|^2
 * x'' = -r H x where s r = t . H t, and y'' = -K y where s K' = -2 s' K.
 */
static void series_of(const double *h, int terms, Series *f) {
  eight left[TERMS], right[TERMS], pulls[TERMS];
  const eight weights = {h[0] * h[0], h[1] * h[1], h[2] * h[2], 0.0, 0.0, h[0], h[1], h[2]};
  double over = 0.0;
  for (int k = 0; k < terms; k++) {
    const eight parts = weights * squared(k, f->all), now = f->all[k];
    double s = parts[0] + parts[1] + parts[2], r = parts[5] + parts[6] + parts[7], gauss;
    left[k] = (eight){s, s, k * s};
    if (k) {
      const eight sums = product(k, 1, left, right);
      r = (r - sums[0]) * over;
      gauss = -(sums[1] + sums[2] / k) * over;
    } else {
      over = 1.0 / s;
      r *= over;
      gauss = h[0] * h[1] * h[2] * over * over;
    }
    right[k] = (eight){r, gauss, gauss};
    pulls[k] = (eight){r, r, r, gauss, gauss};
    const eight bent = product(k, 0, pulls, f->all);
    double share = 1.0 / (k + 1);
    f->all[k + 1] = share * (eight){now[5], now[6], now[7], f->slopes[0][k], f->slopes[1][k],
                                    -h[0] * bent[0], -h[1] * bent[1], -h[2] * bent[2]};
    f->slopes[0][k + 1] = -share * bent[3];
    f->slopes[1][k + 1] = -share * bent[4];
  }
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
