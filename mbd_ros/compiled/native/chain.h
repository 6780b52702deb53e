/* The shortest path between two points over surfaces in a row, by Newton's method, as
 * core/kinematics/paths/shortest_path.py has it.
 */
#define UNKNOWNS (4 * MOST_WRAPS)

/* A surface and where it is: rotation row by row from its axes, then its origin. */
typedef struct {
  const Surface *surface;
  double place[12];
} Placed;

/* An end of a geodesic in common axes: point, frame, changes of the normal along t and b, and
 * shifts along t and b and a turn about n with the four unknowns.
 */
typedef struct {
  double point[3], t[3], b[3], n[3], by_t[3], by_b[3], along[4], aside[4], spin[4];
} Contact;

typedef struct {
  double direction[3], length;
} Line;

static void inwards(const double *place, const double *p, double *out) {
  double d[3] = {p[0] - place[9], p[1] - place[10], p[2] - place[11]};
  for (int i = 0; i < 3; i++)
    out[i] = place[i] * d[0] + place[3 + i] * d[1] + place[6 + i] * d[2];
}

static void turned(const double *place, const double *v, double *out) {
  for (int i = 0; i < 3; i++) out[i] = dot3(place + 3 * i, v);
}

static void outwards(const double *place, const double *p, double *out) {
  turned(place, p, out);
  for (int i = 0; i < 3; i++) out[i] += place[9 + i];
}

static void contact_at(const Placed *one, const double *point, const double *t, Contact *c) {
  double n[3], b[3], by_t[3], by_b[3];
  normal_at(one->surface, point, n);
  cross3(t, n, b);
  bend(one->surface, point, t, by_t);
  bend(one->surface, point, b, by_b);
  outwards(one->place, point, c->point);
  turned(one->place, t, c->t);
  turned(one->place, b, c->b);
  turned(one->place, n, c->n);
  turned(one->place, by_t, c->by_t);
  turned(one->place, by_b, c->by_b);
}

static void line_between(const double *from, const double *to, Line *line) {
  for (int i = 0; i < 3; i++) line->direction[i] = to[i] - from[i];
  line->length = fmax(unit3(line->direction, line->direction), 1.0e-300);
}

/* The slopes of a row by what moves a contact: flat is the row's part square to the line. */
static void add_moves(const double *flat, const Contact *c, double sign, double *row) {
  double by_t = sign * dot3(flat, c->t), by_b = sign * dot3(flat, c->b);
  for (int k = 0; k < 4; k++) row[k] += by_t * c->along[k] + by_b * c->aside[k];
}

/* What the conditions at one contact lack, and their slopes. */
static void conditions(const Contact *c, const Line *line, double sign, const Contact *other,
                       double *errors, double *own, double *beside) {
  const double *e = line->direction, *frame[2] = {c->n, c->b};
  for (int f = 0; f < 2; f++) {
    double flat[3];
    errors[f] = dot3(frame[f], e);
    for (int i = 0; i < 3; i++) flat[i] = (frame[f][i] - errors[f] * e[i]) / line->length;
    add_moves(flat, c, sign, own + f * UNKNOWNS);
    if (other) add_moves(flat, other, -sign, beside + f * UNKNOWNS);
  }
  double n_by_t = dot3(c->by_t, e), n_by_b = dot3(c->by_b, e);
  double b_by_t = -errors[0] * dot3(c->by_t, c->b), b_by_b = -errors[0] * dot3(c->by_b, c->b);
  double b_by_spin = -dot3(c->t, e);
  for (int k = 0; k < 4; k++) {
    own[k] += n_by_t * c->along[k] + n_by_b * c->aside[k];
    own[UNKNOWNS + k] += b_by_t * c->along[k] + b_by_b * c->aside[k] + b_by_spin * c->spin[k];
  }
}

/* Completes geodesics and tells what their path lacks; 0 where one cannot be followed. */
static int link_arcs(const double *a, const double *b, int count, const Placed *over,
                     int is_rough, Arc *arcs, double *errors, double slopes[UNKNOWNS][UNKNOWNS]) {
  Contact ends[MOST_WRAPS][2];
  Line lines[MOST_WRAPS + 1];
  for (int i = 0; i < count; i++) {
    Flow flow;
    if (!follow(over[i].surface, is_rough, arcs + i, &flow)) return 0;
    Contact *first = ends[i], *last = ends[i] + 1;
    contact_at(over + i, arcs[i].start, arcs[i].direction, first);
    contact_at(over + i, arcs[i].end, flow.direction, last);
    for (int k = 0; k < 4; k++) {
      first->along[k] = k == 0;
      first->aside[k] = k == 1;
      first->spin[k] = k == 2;
      last->along[k] = k == 0 || k == 3;
      last->aside[k] = k == 1 ? flow.shifted[0] : k == 2 ? flow.turned[0] : 0.0;
      last->spin[k] = k == 1 ? flow.shifted[1] : k == 2 ? flow.turned[1] : 0.0;
    }
  }
  for (int i = 0; i <= count; i++)
    line_between(i ? ends[i - 1][1].point : a, i < count ? ends[i][0].point : b, lines + i);
  for (int i = 0; i < 4 * count; i++) memset(slopes[i], 0, sizeof slopes[i]);
  for (int i = 0; i < count; i++) {
    double *rows = slopes[4 * i], *own = rows + 4 * i;
    const Contact *before = i ? ends[i - 1] + 1 : 0, *after = i + 1 < count ? ends[i + 1] : 0;
    conditions(ends[i], lines + i, 1.0, before, errors + 4 * i, own, own - 4);
    rows += 2 * UNKNOWNS;
    own += 2 * UNKNOWNS;
    conditions(ends[i] + 1, lines + i + 1, -1.0, after, errors + 4 * i + 2, own, own + 4);
  }
  return 1;
}

/* x = A^-1 x with rows exchanged. */
static void solve(int n, double A[UNKNOWNS][UNKNOWNS], double *x) {
  for (int k = 0; k < n; k++) {
    int best = k;
    for (int i = k + 1; i < n; i++) if (fabs(A[i][k]) > fabs(A[best][k])) best = i;
    for (int j = k; best != k && j < n; j++) {
      double kept = A[k][j];
      A[k][j] = A[best][j];
      A[best][j] = kept;
    }
    double kept = x[k];
    x[k] = x[best];
    x[best] = kept;
    for (int i = k + 1; i < n; i++) {
      double share = A[i][k] / A[k][k];
      for (int j = k + 1; j < n; j++) A[i][j] -= share * A[k][j];
      x[i] -= share * x[k];
    }
  }
  for (int k = n - 1; k >= 0; k--) {
    for (int j = k + 1; j < n; j++) x[k] -= A[k][j] * x[j];
    x[k] /= A[k][k];
  }
}

/* A geodesic after a step of its unknowns, kept on the surface. */
static void move_arc(const Surface *s, const double *step, Arc *arc) {
  double n[3], b[3], far = fmax(fmax(fabs(step[0]), fabs(step[1])), fabs(step[3])) / s->size;
  double share = 1.0 / fmax(fmax(far, fabs(step[2])) / 0.5, 1.0);
  normal_at(s, arc->start, n);
  cross3(arc->direction, n, b);
  for (int i = 0; i < 3; i++)
    arc->start[i] += share * (step[0] * arc->direction[i] + step[1] * b[i]);
  put_on(s, arc->start);
  normal_at(s, arc->start, n);
  for (int i = 0; i < 3; i++) arc->direction[i] += share * step[2] * b[i];
  double off = dot3(arc->direction, n), most = 20.0 * s->size;
  for (int i = 0; i < 3; i++) arc->direction[i] -= off * n[i];
  unit3(arc->direction, arc->direction);
  arc->length = fmin(fmax(arc->length + share * step[3], -most), most);
}

/* Newton's method from a guess, with steps that are halved until they help; whether it got there.
 * Far from the solution geodesics are followed roughly.
 */
static int shortest(const double *a, const double *b, int count, const Placed *over, Arc *arcs) {
  double steps[UNKNOWNS] = {0.0}, slopes[UNKNOWNS][UNKNOWNS], share = 1.0, best = INFINITY;
  int n = 4 * count, is_rough = 0;
  for (int round = 0; round < 30; round++) {
    Arc tried[MOST_WRAPS];
    double scaled[UNKNOWNS], errors[UNKNOWNS], worst = 0.0;
    int was_rough = is_rough;
    is_rough = best > 1.0e-3;
    for (int i = 0; i < n; i++) scaled[i] = share * steps[i];
    for (int i = 0; i < count; i++) {
      tried[i] = arcs[i];
      move_arc(over[i].surface, scaled + 4 * i, tried + i);
    }
    if (!link_arcs(a, b, count, over, is_rough, tried, errors, slopes)) return 0;
    for (int i = 0; i < n; i++) worst += errors[i] * errors[i];
    worst = sqrt(worst);
    int is_better = worst < best || share <= 0x1p-8 || was_rough > is_rough;
    if (!is_better && best < 1.0e-10) return 1;
    if (!is_better) {
      share /= 2.0;
      continue;
    }
    memcpy(arcs, tried, count * sizeof *arcs);
    if (worst < 1.0e-13 && !is_rough) return 1;
    best = worst;
    share = 1.0;
    for (int i = 0; i < n; i++) {
      slopes[i][i] += 1.0e-12;
      steps[i] = -errors[i];
    }
    solve(n, slopes, steps);
  }
  return 0;
}
