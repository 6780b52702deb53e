/* Wraps over the inner side of a ring about z; `size` is the radius of the tube, `a[0]` that of
 * the circle. Geodesics by Taylor series.
 */

/* The middle of the tube beside a point; direction away from z. */
static double ring_at(const Surface *s, const double *p, double *out, double *middle) {
  double rho = fmax(sqrt(p[0] * p[0] + p[1] * p[1]), 1.0e-300);
  for (int i = 0; i < 3; i++) {
    out[i] = i < 2 ? p[i] / rho : 0.0;
    middle[i] = s->a[0] * out[i];
  }
  return rho;
}

static double from_ring(const Surface *s, const double *p, double *n) {
  double out[3], middle[3];
  ring_at(s, p, out, middle);
  for (int i = 0; i < 3; i++) n[i] = p[i] - middle[i];
  return unit3(n, n);
}

/* The point of the line through a and b that is nearest to the circle. */
static void nearest_to_ring(const Surface *s, const double *a, const double *b, double *near) {
  double line[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]}, n[3], least = INFINITY, at = 0.0;
  double square = dot3(line, line), flat = line[0] * line[0] + line[1] * line[1];
  for (int k = 0; k <= 60; k++) {
    double way = -1.0 + 0.05 * k;
    for (int i = 0; i < 3; i++) near[i] = a[i] + way * line[i];
    double distance = from_ring(s, near, n);
    if (distance < least) least = distance, at = way;
  }
  for (int step = 0; step < 30; step++) {
    for (int i = 0; i < 3; i++) near[i] = a[i] + at * line[i];
    double rho = fmax(hypot(near[0], near[1]), 1.0e-300);
    double radial = (near[0] * line[0] + near[1] * line[1]) / rho;
    double slope = dot3(near, line) - s->a[0] * radial;
    double bent = square - s->a[0] * (flat - radial * radial) / rho;
    double way = slope / (bent > 0.0 ? bent : square);
    at -= fmin(fmax(way, -0.05), 0.05);
    if (!(fabs(way) > 1.0e-15)) break;
  }
  for (int i = 0; i < 3; i++) near[i] = a[i] + at * line[i];
}

/* The cylinder along the ring where a line comes nearest to it, and the ends in its axes. */
static Surface beside_ring(const Surface *s, const double *near, const double *a, const double *b,
                           double *place, double *in_a, double *in_b) {
  double out[3], middle[3], *rows[3] = {place, place + 3, place + 6};
  ring_at(s, near, out, middle);
  for (int i = 0; i < 3; i++) {
    rows[0][i] = -out[i];
    rows[1][i] = i == 2 ? -1.0 : 0.0;
    place[9 + i] = middle[i];
  }
  cross3(rows[0], rows[1], rows[2]);
  for (int i = 0; i < 3; i++) in_a[i] = a[i] - middle[i], in_b[i] = b[i] - middle[i];
  double from[3] = {in_a[0], in_a[1], in_a[2]}, to[3] = {in_b[0], in_b[1], in_b[2]};
  for (int i = 0; i < 3; i++) in_a[i] = dot3(rows[i], from), in_b[i] = dot3(rows[i], to);
  return (Surface){CYLINDER, 0, 1.0, s->size, 500.0 * s->a[0], {0.0}};
}

static int torus_meets(const Surface *s, const double *a, const double *b) {
  double near[3], place[12], in_a[3], in_b[3], n[3];
  if (from_ring(s, a, n) < s->size || from_ring(s, b, n) < s->size) return NO_WRAP;
  nearest_to_ring(s, a, b, near);
  if (s->sign != 0.0 && !on_side(s, near)) return NO_WRAP;
  Surface beside = beside_ring(s, near, a, b, place, in_a, in_b);
  return cylinder_meets(&beside, in_a, in_b) == NO_WRAP ? NO_WRAP : MAY_WRAP;
}

static int torus_touch(const Surface *s, const double *a, const double *b, int code, Arc *arc) {
  double near[3], place[12], in_a[3], in_b[3], n[3], out[3], middle[3];
  Arc found;
  nearest_to_ring(s, a, b, near);
  Surface beside = beside_ring(s, near, a, b, place, in_a, in_b);
  code = cylinder_touch(&beside, in_a, in_b, code, &found);
  for (int i = 0; i < 3; i++) {
    arc->start[i] = place[9 + i];
    arc->direction[i] = 0.0;
    for (int k = 0; k < 3; k++) {
      arc->start[i] += place[3 * k + i] * found.start[k];
      arc->direction[i] += place[3 * k + i] * found.direction[k];
    }
  }
  ring_at(s, arc->start, out, middle);
  from_ring(s, arc->start, n);
  for (int i = 0; i < 3; i++) arc->start[i] = middle[i] + s->size * n[i];
  from_ring(s, arc->start, n);
  double off = dot3(arc->direction, n);
  for (int i = 0; i < 3; i++) arc->direction[i] -= off * n[i];
  unit3(arc->direction, arc->direction);
  arc->length = found.length;
  return code;
}

/* Change of the normal along a tangent. */
static void torus_bend(const Surface *s, const double *p, const double *along, double *out) {
  double away[3], middle[3], rho = ring_at(s, p, away, middle);
  double around = s->a[0] / rho * (away[0] * along[1] - away[1] * along[0]);
  out[0] = (along[0] + around * away[1]) / s->size;
  out[1] = (along[1] - around * away[0]) / s->size;
  out[2] = along[2] / s->size;
}

static double convolved(int k, int first, const double *a, const double *b) {
  double sum = 0.0;
  for (int j = first; j <= k; j++) sum += a[j] * b[k - j];
  return sum;
}

/* Series of a geodesic and of its Jacobi fields: with rho^2 = x^2 + y^2 and the rate of the angle
 * about z times rho, g = (x y' - y x') / rho, x'' = -(1 - R g^2 / rho) n / r, K = (rho - R) / (r^2 rho).
 */
static void torus_series(const Surface *s, int terms, Series *f) {
  double c[8][TERMS + 1], rho[TERMS], over[TERMS], turn[TERMS], g[TERMS], gg[TERMS], bend[TERMS];
  double gauss[TERMS], n[3][TERMS], square = 1.0 / (s->size * s->size), R = s->a[0];
  for (int i = 0; i < 8; i++) c[i][0] = f->all[0][i];
  for (int k = 0; k < terms; k++) {
    double share = 1.0 / (k + 1);
    double flat = convolved(k, 0, c[0], c[0]) + convolved(k, 0, c[1], c[1]);
    if (k) {
      double sum = 0.0;
      for (int j = 1; j < k; j++) sum += rho[j] * rho[k - j];
      rho[k] = (flat - sum) / (2.0 * rho[0]);
      over[k] = -convolved(k, 1, rho, over) / rho[0];
    } else {
      rho[0] = sqrt(flat);
      over[0] = 1.0 / rho[0];
    }
    turn[k] = convolved(k, 0, c[0], c[6]) - convolved(k, 0, c[1], c[5]);
    g[k] = convolved(k, 0, turn, over);
    gg[k] = convolved(k, 0, g, g);
    bend[k] = square * ((k == 0) - R * convolved(k, 0, over, gg));
    gauss[k] = square * ((k == 0) - R * over[k]);
    for (int i = 0; i < 2; i++) n[i][k] = c[i][k] - R * convolved(k, 0, c[i], over);
    n[2][k] = c[2][k];
    for (int i = 0; i < 3; i++) {
      c[i][k + 1] = share * c[5 + i][k];
      c[5 + i][k + 1] = -share * convolved(k, 0, bend, n[i]);
    }
    for (int i = 0; i < 2; i++) {
      f->slopes[i][k + 1] = -share * convolved(k, 0, gauss, c[3 + i]);
      c[3 + i][k + 1] = share * f->slopes[i][k];
    }
    for (int i = 0; i < 8; i++) f->all[k + 1][i] = c[i][k + 1];
  }
}
