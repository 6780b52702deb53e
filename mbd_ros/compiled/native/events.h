/* Rows that give way: looks after a step, and states on the rows that are on.
 *
 * The mode stands in p behind the NP parameters: 0 for a row that is on, 1 or -1 at a bound.
 */
#if LANES == 1
#if MODES
#define WAYS(o) ((o)->p + NP)
#define MOVES 4
#define ON_SURFACE 1.0e-12

static double spacing(double x) {
  return nextafter(x, INFINITY) - x;
}

static int has_on(const Options *o) {
  for (long i = 0; i < MODES; i++)
    if (WAYS(o)[i] == 0.0) return 1;
  return 0;
}

static double rounding(const double *q, const double *w) {
  return ON_SURFACE * (1.0 + fmax(largest(NQ, q), largest(NV, w)));
}

/* What forces say of the mode at a state: margins, rates of slips, and how long a step may be. */
static void ask_forces(const Options *o, Run *r, double t, const double *q, const double *w,
                       double *margins, double *rates, double *length) {
  double whole[NOT_ZERO(NU)], z[NOT_ZERO(NZ)], a[NOT_ZERO(NW)];
  const double *u = r->u;
  double health = r->health;
  evaluate(o, r, t, q, w, a);
  r->health = health;  /* that of steps counts */
  r->evaluations -= 1.0;
  for (long i = 0; i < NZ; i++) z[i] = fmin(fmax(w[NV + i], o->lower[i]), o->upper[i]);
  if (NU && o->smooth) {
    complete_inputs(o, r->u, t, whole);
    u = whole;
  }
  answers(&t, q, w, z, u, o->p, a, r->pushes, margins, rates, length, r->work);
}

/* Whether the margins of a state are those of the mode; `spans` of rows, rates of heights. */
static int is_in_mode(const Options *o, Run *r, double t, const double *q, const double *w,
                      double *spans, double *rates) {
  double slack = rounding(q, w), of_forces[NOT_ZERO(ANSWERS)], more[MODES], margins[MODES];
  double names, length;
  int is_kept = 1;
  heights(&t, q, w, o->p, margins, rates, spans, &names, r->work);
  for (long i = 0; i < MODES; i++)
    if (!(margins[i] >= (r->left[i] ? -slack : 0.0))) is_kept = 0;
  if (ASKS_ALWAYS || has_on(o)) {
    ask_forces(o, r, t, q, w, of_forces, more, &length);
    for (long i = 0; i < ANSWERS; i++)
      if (!(of_forces[i] >= 0.0)) is_kept = 0;
    for (long i = 0; i < MODES; i++) rates[i] += more[i];
  }
  return is_kept;
}

/* Whether the mode may have ended in the last step: by its end; by its middle where forces decide;
 * or since a row was approached and then left.
 */
static int look(const Options *o, Run *r) {
  double spans[MODES], last[MODES], rates[MODES], q[NOT_ZERO(NQ)], w[NOT_ZERO(NW)];
  double slack = rounding(r->q0, r->w0);
  if (!r->is_looked) is_in_mode(o, r, r->t0, r->q0, r->w0, spans, r->approach);
  r->is_looked = 0.0;
  if (HAS_DEMANDS || has_on(o)) {
    double middle = r->t0 + 0.5 * (r->t - r->t0);
    state_at(o, r, middle, q, w);
    if (!is_in_mode(o, r, middle, q, w, spans, rates)) return GUARD;
  }
  if (!is_in_mode(o, r, r->t, r->q, r->w, spans, last)) return GUARD;
  for (long i = 0; i < MODES; i++) {
    int is_beside = WAYS(o)[i] != 0.0 && !r->left[i];
    if (is_beside && !(r->approach[i] >= -slack) && !(last[i] <= 0.0)) return GUARD;
  }
  slack = rounding(r->q, r->w);
  for (long i = 0; i < MODES; i++) r->left[i] = r->left[i] && fabs(spans[i]) <= slack;
  copy(MODES, last, r->approach);
  r->is_looked = 1.0;
  return DONE;
}

/* Ends a step where slips that turn have changed by much; they may need other names before it. */
static int follow_slips(const Options *o, Run *r, double *end) {
#if CONTACTS
  double margins[MODES], rates[MODES], spans[MODES], of_forces[NOT_ZERO(ANSWERS)];
  double names, length;
  if (!has_on(o)) return DONE;
  heights(&r->t, r->q, r->w, o->p, margins, rates, spans, &names, r->work);
  if (names == 0.0) return RENAMED;
  if (names > 1.0) {
    ask_forces(o, r, r->t, r->q, r->w, of_forces, rates, &length);
    *end = fmin(*end, r->t + length);
  }
#endif
  return DONE;
}

/* The state on the rows that are on, moved as their forces move it; whether it has moved. */
static int onto(const Options *o, Run *r, double t, double *q, double *w) {
  int has_moved = 0;
  if (!has_on(o)) return 0;
#if GAPS
  double dq[NOT_ZERO(NV)], g[GAPS], there[NOT_ZERO(NQ)];
  for (long i = 0; i < MOVES; i++) {
    land(&t, q, o->p, dq, g, r->work);
    if (largest(GAPS, g) <= spacing(1.0 + largest(NQ, q))) break;
    move(q, dq, there, r->work);
    copy(NQ, there, q);
    has_moved = 1;
  }
#endif
#if STAYS
  double dv[NOT_ZERO(NV)], rates[STAYS];
  stay(&t, q, w, o->p, dv, rates, r->work);
  if (largest(STAYS, rates) > spacing(largest(NV, w))) {
    for (long i = 0; i < NV; i++) w[i] += dv[i];
    has_moved = 1;
  }
#endif
  return has_moved;
}
#endif

/* A state moved onto the rigid rows, where that is the stabilization. */
static int projected(const Options *o, Run *r, double t, double *q, double *w) {
#if IS_PROJECTED
  return project(o, r, t, q, w);
#else
  return DONE;
#endif
}

/* A state inside a step, moved onto what holds in it. */
static int correct_at(const Options *o, Run *r, double t, double *q, double *w) {
#if MODES
  onto(o, r, t, q, w);
#endif
  return projected(o, r, t, q, w);
}

/* The end of a step, moved onto what holds in it. */
static int correct(const Options *o, Run *r) {
#if MODES
  if (onto(o, r, r->t, r->q, r->w)) forget_history(r);
#endif
  if (IS_PROJECTED) r->is_after = 0.0;
  return projected(o, r, r->t, r->q, r->w);
}

/* One step in which the mode does not end; it stands behind the step where it may have ended. */
static int step_in_mode(const Options *o, Run *r, double end) {
  double before = r->steps;
#if MODES
  int status = follow_slips(o, r, &end);
  if (status != DONE) return status;
  status = one_step(o, r, end);
#else
  int status = one_step(o, r, end);
#endif
#if MODES
  if (status != DONE || r->steps == before) return status;
  status = look(o, r);
  if (status != DONE) r->steps = before;
#endif
  return status;
}
#endif
