/* Surfaces that paths wrap over, one sample at a time, as in core/model/wrapping: cylinder and
 * sphere, in axes of their own. Sources of the formulas are named there.
 */
#include <math.h>
#include <string.h>

enum kind { CYLINDER, SPHERE, ELLIPSOID, TORUS };
enum code { NO_WRAP, MAY_WRAP, MUST_WRAP };

typedef struct {
  int kind, axis;
  double sign, size, half;  /* sign: of the half that paths go over, 0 for all */
  double a[3];              /* half axes; of a torus the radius of its circle */
} Surface;

/* A geodesic: where it starts, which way, how far, and points half-way and at its end. */
typedef struct {
  double start[3], direction[3], length, middle[3], end[3];
} Arc;

/* Its end, and two Jacobi fields there, each with its slope. */
typedef struct {
  double direction[3], shifted[2], turned[2];
} Flow;

static double dot3(const double *a, const double *b) {
  return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

static void cross3(const double *a, const double *b, double *out) {
  out[0] = a[1] * b[2] - a[2] * b[1];
  out[1] = a[2] * b[0] - a[0] * b[2];
  out[2] = a[0] * b[1] - a[1] * b[0];
}

static double unit3(const double *v, double *out) {
  double length = sqrt(dot3(v, v)), over = length > 0.0 ? 1.0 / length : 1.0;
  for (int i = 0; i < 3; i++) out[i] = v[i] * over;
  return length;
}

static double remainder_of(double x, double period) {
  return x - period * floor(x / period);
}

static int on_side(const Surface *s, const double *p) {
  return (p[s->axis] >= 0.0) == (s->sign > 0.0);
}

/* Whether a line meets a sphere about the origin between its ends; the middle of what is inside. */
static int crossing(const double *a, const double *b, double radius, double *middle) {
  double line[3] = {b[0] - a[0], b[1] - a[1], b[2] - a[2]};
  double square = dot3(line, line), along = dot3(a, line);
  if (!(square > 0.0)) square = 1.0;
  double root = along * along - square * (dot3(a, a) - radius * radius);
  double half = sqrt(root > 0.0 ? root : 0.0) / square, at = -along / square;
  for (int i = 0; i < 3; i++) middle[i] = a[i] + at * line[i];
  return root >= 0.0 && at - half > 0.0 && at + half < 1.0;
}

/* Distance along z to the point of contact of a tangent, and its angle about z. */
static double cylinder_tangent(const Surface *s, const double *p, double turn, double *angle) {
  double square = p[0] * p[0] + p[1] * p[1] - s->size * s->size;
  double distance = sqrt(square > 0.0 ? square : 0.0);
  *angle = atan2(p[1], p[0]) + turn * atan2(distance, s->size);
  return distance;
}

static int angle_on_side(const Surface *s, double angle, double z) {
  double p[3] = {s->size * cos(angle), s->size * sin(angle), z};
  return on_side(s, p);
}

static int cylinder_turns_left(const Surface *s, const double *a, const double *b) {
  double left_a, right_a, left_b, right_b;
  cylinder_tangent(s, a, 1.0, &left_a);
  cylinder_tangent(s, a, -1.0, &right_a);
  cylinder_tangent(s, b, 1.0, &left_b);
  cylinder_tangent(s, b, -1.0, &right_b);
  int on[4] = {angle_on_side(s, left_a, a[2]), angle_on_side(s, right_a, a[2]),
               angle_on_side(s, left_b, b[2]), angle_on_side(s, right_b, b[2])};
  if (on[0] != on[1]) return on[0];
  if (on[0] || on[2] || on[3]) return !on[2];
  return acos(cos(left_a - right_b)) > acos(cos(right_a - left_b));
}

static int cylinder_meets(const Surface *s, const double *a, const double *b) {
  double x = b[0] - a[0], y = b[1] - a[1], flat = x * x + y * y, square = s->size * s->size;
  double at = -(a[0] * x + a[1] * y) / (flat > 0.0 ? flat : 1.0);
  double near[3] = {a[0] + at * x, a[1] + at * y, a[2] + at * (b[2] - a[2])};
  if (a[0] * a[0] + a[1] * a[1] < square || b[0] * b[0] + b[1] * b[1] < square) return NO_WRAP;
  int hits = near[0] * near[0] + near[1] * near[1] < square && at > 0.0 && at < 1.0;
  if (s->sign == 0.0) return hits ? MUST_WRAP : NO_WRAP;
  int from = on_side(s, a), to = on_side(s, b);
  if (!(from || to)) return MAY_WRAP;
  if (hits) return MUST_WRAP;
  return from != to && !on_side(s, near) ? MAY_WRAP : NO_WRAP;
}

static int cylinder_touch(const Surface *s, const double *a, const double *b, int code, Arc *arc) {
  int left = s->sign != 0.0 ? cylinder_turns_left(s, a, b) : a[0] * b[1] - a[1] * b[0] >= 0.0;
  double turn = left ? 1.0 : -1.0, begin, end, radius = s->size;
  double to_a = cylinder_tangent(s, a, turn, &begin), to_b = cylinder_tangent(s, b, -turn, &end);
  double angle = remainder_of(turn * (end - begin), 2.0 * M_PI);
  if (angle > 2.0 * M_PI - 1.0e-9) angle = 0.0;
  double slope = (b[2] - a[2]) / (to_a + radius * angle + to_b);
  double first = a[2] + slope * to_a, last = b[2] - slope * to_b;
  double c = cos(begin), sine = sin(begin), steep = sqrt(1.0 + slope * slope);
  Arc found = {{radius * c, radius * sine, first},
               {-turn * sine / steep, turn * c / steep, slope / steep},
               radius * angle * steep, {0.0}, {0.0}};
  *arc = found;
  return fabs(first) > s->half && fabs(last) > s->half ? NO_WRAP : code;
}

static void cylinder_flow(const Surface *s, Arc *arc, Flow *flow) {
  double nx = arc->start[0] / s->size, ny = arc->start[1] / s->size;
  double around = arc->direction[1] * nx - arc->direction[0] * ny, rise = arc->direction[2];
  double angle = around * arc->length / s->size, c = cos(angle), sine = sin(angle);
  double x = c * nx - sine * ny, y = sine * nx + c * ny;
  double end[3] = {s->size * x, s->size * y, arc->start[2] + rise * arc->length};
  Flow found = {{-around * y, around * x, rise}, {1.0, 0.0}, {arc->length, 1.0}};
  *flow = found;
  for (int i = 0; i < 3; i++) arc->middle[i] = 0.5 * (arc->start[i] + end[i]);
  memcpy(arc->end, end, sizeof end);
}

/* A unit vector square to another one. */
static void across(const double *axis, double *out) {
  int least = 0;
  for (int i = 1; i < 3; i++) if (fabs(axis[i]) < fabs(axis[least])) least = i;
  double e[3] = {0.0, 0.0, 0.0};
  e[least] = 1.0;
  cross3(axis, e, out);
  unit3(out, out);
}

static void any_plane(const Surface *s, const double *a, double *out) {
  double e[3] = {0.0, 0.0, 0.0};
  e[s->axis] = s->sign;
  cross3(a, e, out);
  if (s->sign == 0.0 || dot3(out, out) < 1.0e-20 * dot3(a, a)) across(a, out);
}

static int sphere_touch(const Surface *s, const double *a, const double *b, int code, Arc *arc) {
  double ahead[3], normal[3], side[3], over_a = unit3(a, ahead), over_b = sqrt(dot3(b, b));
  cross3(a, b, normal);
  double length = sqrt(dot3(normal, normal)), angle = atan2(length, dot3(a, b)), way = 1.0;
  if (length < 1.0e-12 * over_a * over_b) any_plane(s, a, normal);
  double rim_a = acos(fmin(s->size / over_a, 1.0)), rim_b = acos(fmin(s->size / over_b, 1.0));
  cross3(normal, ahead, side);
  unit3(side, side);
  if (s->sign != 0.0 && !(on_side(s, a) && on_side(s, b))) {
    double sums = -(a[s->axis] + b[s->axis]), at[2] = {-rim_a, angle + rim_b};
    for (int i = 0; i < 2; i++)
      sums += s->size * (cos(at[i]) * ahead[s->axis] + sin(at[i]) * side[s->axis]);
    if (s->sign * sums >= 0.0) way = -1.0;
  }
  double turned = (way < 0.0 ? 2.0 * M_PI - angle : angle) - rim_a - rim_b;
  double c = cos(rim_a), sine = sin(rim_a);
  for (int i = 0; i < 3; i++) {
    arc->start[i] = s->size * (c * ahead[i] + sine * way * side[i]);
    arc->direction[i] = c * way * side[i] - sine * ahead[i];
  }
  arc->length = s->size * fmax(turned, 0.0);
  return code;
}

static void sphere_flow(const Surface *s, Arc *arc, Flow *flow) {
  double r = s->size, angle = arc->length / r, c = cos(angle), sine = sin(angle);
  Flow found = {{0.0}, {c, -sine / r}, {r * sine, c}};
  for (int i = 0; i < 3; i++) {
    double start = arc->start[i], ahead = r * arc->direction[i];
    found.direction[i] = arc->direction[i] * c - start * sine / r;
    arc->end[i] = start * c + ahead * sine;
    arc->middle[i] = start * (1.0 + c) + ahead * sine;
  }
  unit3(arc->middle, arc->middle);
  for (int i = 0; i < 3; i++) arc->middle[i] *= r;
  *flow = found;
}
