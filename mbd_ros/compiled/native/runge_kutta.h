/* One step of an explicit Runge-Kutta method, in the chart of the state that it starts from.
 *
 *   q(t) = q0 (+) dq(t),   dq' = rate(dq, v),   w' = (a, z')(t, q, v, z, u)
 *
 * Source: Iserles, Munthe-Kaas, Norsett, Zanna, Lie-group methods, Acta Numerica 9, 2000, 4.2;
 * step lengths: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, 1993, II.4,
 * II.10; Hairer, Wanner, II, 1996, IV.2 for PI control.
 */
#define SAFETY 0.9
#define LEAST_FACTOR 0.2
#define MOST_FACTOR 6.0
#define PI_MEMORY 0.04
#define NO_ERROR 1.0e-10
#define SMALL_ERROR 1.0e-4
#define SHORTEST 1.0e-10  /* in dt */
#define PROBE 0.01        /* in dt */

/* The state that weights of the rates make: q0 (+) dq, w0 + dw; dq too. */
static void stage(Run *r, Weights by, long row, real *dq, real *q, real *w) {
  real d[NR];
  sum_rates(by, row, r->h, (const real (*)[NR])r->rates, d);
  copy(NV, d, dq);
  move(r->q0, d, q, r->work);
  for (long i = 0; i < NW; i++) w[i] = r->w0[i] + d[NV + i];
}

/* Rates up to `count`, which may be beyond those of the step. */
static void complete(const Options *o, Run *r, long count) {
  for (long i = (long)r->done; i < count; i++) {
    real dq[NOT_ZERO(NV)], q[NOT_ZERO(NQ)], w[NOT_ZERO(NW)];
    stage(r, o->tableau.a, i, dq, q, w);
    chart_rate(dq, w, r->rates[i], r->work);
    evaluate(o, r, r->t0 + r->h * o->tableau.c[i], q, w, r->rates[i] + NV);
    r->done = i + 1;
  }
}

/* Begin a step where the run stands: the first rate, at hand after a step that ended there. */
static void begin_step(const Options *o, Run *r) {
  long end = o->tableau.stages;
  int is_known = r->is_after && r->done > end;
  if (is_known) {
    copy(NW, r->rates[end] + NV, r->rates[0] + NV);
  } else {
    evaluate(o, r, r->t, r->q, r->w, r->rates[0] + NV);
  }
  copy(NV, r->w, r->rates[0]);
  keep_start(r);
  r->done = 1.0, r->is_after = r->is_dense = 0.0;
}

/* End of a step of length h [s] from where it began; t is its time [s]. */
static void advance_step(const Options *o, Run *r, double h, double t) {
  real dq[NOT_ZERO(NV)];
  r->h = h, r->done = 1.0, r->is_dense = 0.0;
  complete(o, r, o->tableau.stages);
  stage(r, o->tableau.a, o->tableau.stages, dq, r->q1, r->w1);
  r->t1 = t;
}

/* The run goes on from the end of the step. */
static void accept_step(Run *r) {
  r->t = r->t1;
  copy(NQ, r->q1, r->q);
  copy(NW, r->w1, r->w);
  r->is_after = 1.0;
}

/* State inside the last step by the dense output. */
static void runge_kutta_at(const Options *o, Run *r, double t, real *q, real *w) {
  const Tableau *m = &o->tableau;
  if (t == r->t1) {
    copy(NQ, r->q1, q);
    copy(NW, r->w1, w);
    return;
  }
  if (!r->is_dense) {
    complete(o, r, m->all);
    for (long i = 0; i < m->terms; i++)
      sum_rates(m->dense, i, r->h, (const real (*)[NR])r->rates, r->dense[i]);
    r->is_dense = 1.0;
  }
  double theta = (t - r->t0) / r->h, parts[MOST_TERMS];
  real d[NR];
  for (long i = 0; i < m->terms; i++) parts[i] = i % 2 ? 1.0 - theta : theta;
  sum_nested(m->terms, parts, (const real (*)[NR])r->dense, d);
  move(r->q0, d, q, r->work);
  for (long i = 0; i < NW; i++) w[i] = r->w0[i] + d[NV + i];
}

#if LANES == 1
/* Size of an error that counts as one; infinite for the integrals of internal states. */
static void error_sizes(const Options *o, const Run *r, double *scale) {
  for (long i = 0; i < NV; i++) {
    scale[i] = o->tolerance * ((IS_FLAT ? fabs(r->q0[i]) : 0.0) + 1.0);
    scale[NV + i] = o->tolerance * (fabs(r->w0[i]) + 1.0);
  }
  for (long i = 0; i < NZ; i++)
    scale[2 * NV + i] = o->tolerance * (fabs(r->w0[NV + i]) + o->sizes[i]);
}

static double mean_square(const double *e, const double *scale) {
  double sum = 0.0;
  for (long i = 0; i < NR; i++) sum += (e[i] / scale[i]) * (e[i] / scale[i]);
  return sum;
}

/* Root mean square of an error estimate, or of the two of DOP853 combined. */
static double step_error(const Options *o, Run *r, const double *scale) {
  double e[NR], square;
  complete(o, r, o->tableau.weighed);
  sum_rates(o->tableau.error, 0, r->h, (const real (*)[NR])r->rates, e);
  square = mean_square(e, scale);
  if (o->tableau.errors == 2) {
    sum_rates(o->tableau.error, 1, r->h, (const real (*)[NR])r->rates, e);
    double whole = square + 0.01 * mean_square(e, scale);
    if (whole) square = square * square / whole;
  }
  return sqrt(square / (2 * NW));
}

/* Length of a first step from the slope and its change over a short Euler step. */
static double first_length(const Options *o, Run *r, const double *scale) {
  double probe = PROBE * o->dt, dq[NOT_ZERO(NV)], q[NOT_ZERO(NQ)], w[NOT_ZERO(NW)];
  double there[NR], *here = r->rates[0];
  for (long i = 0; i < NV; i++) dq[i] = probe * r->w0[i];
  for (long i = 0; i < NW; i++) w[i] = r->w0[i] + probe * here[NV + i];
  move(r->q0, dq, q, r->work);
  evaluate(o, r, r->t0 + probe, q, w, there + NV);
  for (long i = 0; i < NV; i++) there[i] = w[i] - here[i];
  for (long i = NV; i < NR; i++) there[i] -= here[i];
  double slope = sqrt(mean_square(here, scale) / (2 * NW));
  double bend = sqrt(mean_square(there, scale) / (2 * NW)) / probe;
  double steepest = bend > slope ? bend : slope;
  if (!(steepest > 0.0)) return o->dt;
  return fmin(o->dt, pow(0.01 / steepest, o->tableau.power));
}

/* Change of the length after an accepted step. */
static double next_factor(const Options *o, Run *r, double error) {
  error = fmax(error, NO_ERROR);
  double factor = pow(error, 0.75 * PI_MEMORY - o->tableau.power) * pow(r->last_error, PI_MEMORY);
  r->last_error = fmax(error, SMALL_ERROR);
  return fmax(LEAST_FACTOR, SAFETY * factor);
}

/* One step of its own length, not beyond `end`. */
static int adaptive_step(const Options *o, Run *r, double end) {
  double left = end - r->t, most = MOST_FACTOR, scale[NR], h, error;
  int is_last;
  begin_step(o, r);
  error_sizes(o, r, scale);
  if (r->length == 0.0) r->length = first_length(o, r, scale);
  for (;;) {
    is_last = left <= 1.01 * r->length;
    h = is_last ? left : r->length;
    advance_step(o, r, h, is_last ? end : r->t0 + h);
    error = step_error(o, r, scale);
    if (r->health < o->least_health) return ILL_CONDITIONED;
    if (error < 1.0) break;
    double factor = SAFETY * pow(error, -o->tableau.power);
    most = 1.0, r->length = h * (factor > LEAST_FACTOR ? factor : LEAST_FACTOR);
    double ulp = nextafter(fabs(r->t0), INFINITY) - fabs(r->t0);
    if (!(r->length > fmax(SHORTEST * o->dt, 8.0 * ulp))) return TOO_SHORT;
  }
  double longer = h * fmin(most, next_factor(o, r, error));
  r->length = is_last ? fmax(longer, r->length) : longer;
  accept_step(r);
  return DONE;
}
#endif

/* One step of length h [s] that ends at t [s]. */
static int runge_kutta_step(const Options *o, Run *r, double h, double t) {
  begin_step(o, r);
  advance_step(o, r, h, t);
  if (is_ill(o, r)) return ILL_CONDITIONED;
  accept_step(r);
  return DONE;
}
