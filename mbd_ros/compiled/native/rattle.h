/* RATTLE in the rates of a system with rows.
 *
 *   w  = v + h/2 a(q, w) - lift(q) s,   g(q+) = 0,   q+ = q (+) h w
 *   v+ = w + h/2 a(q+, w) - lift(q+) (J(q+) (w + h/2 a) + dg/dt)
 *
 * a are accelerations with multipliers: they differ from those without by lift times something,
 * which s and the last projection take back. Source: Andersen, J. Comput. Phys. 52, 1983, 24-34;
 * Hairer, Lubich, Wanner, Geometric Numerical Integration, VII.1.4.
 */
#if IS_RATTLE
#define CHORD 10
#define FORESEEN 1.0e-2  /* of the tolerance */
#define FIXED_POINT 50
#define SAME_VELOCITY 1.0e-10

/* v = w - lift s, q = q0 (+) h v */
static void move_with(Run *r, const double *lifts, double h, const double *w, double *v,
                      double *q) {
  double dq[NOT_ZERO(NV)];
  for (long i = 0; i < NV; i++) {
    v[i] = w[i];
    for (long j = 0; j < NG; j++) v[i] -= lifts[i + j * NV] * r->s[j];
    dq[i] = h * v[i];
  }
  move(r->q0, dq, q, r->work);
}

/* The s with g(t, q0 (+) h (w - lift s)) = 0; w and q become those of the step. */
static int move_onto_rows(const Options *o, Run *r, const double *lifts, double h, double t,
                          double *w, double *q) {
  double v[NOT_ZERO(NV)];
  int status = DONE;
#if NG
  double g[NG], open, share = 1.0, last = INFINITY;
  for (long n = 0; n < CHORD; n++) {
    move_with(r, lifts, h, w, v, q);
    gap(&t, q, o->p, g, r->work);
    open = largest(NG, g), share = open / last, last = open;
    if (!(share < 0.5)) return OPEN;
    for (long j = 0; j < NG; j++) r->s[j] += g[j] / h;
    status = open <= o->closed || open * share <= FORESEEN * o->closed ? DONE : OPEN;
    if (status == DONE) break;
  }
#endif
  move_with(r, lifts, h, w, v, q);
  copy(NV, v, w);
  return status;
}

/* The velocity of the step, by iteration where forces depend on it. */
static int kick(const Options *o, Run *r, const double *lifts, double h, double t, double *w,
                double *q) {
  double first[NOT_ZERO(NG)], a[NOT_ZERO(NW)], last[NOT_ZERO(NW)], change;
  double same = SAME_VELOCITY * fmax(1.0, largest(NW, r->w0));
  for (long j = 0; j < NG; j++) first[j] = r->s[j], r->s[j] = 2.0 * r->s[j] - r->s_before[j];
  copy(NG, first, r->s_before);
  copy(NW, r->force, a);
  for (long n = 0; n < FIXED_POINT; n++) {
    for (long i = 0; i < NW; i++) w[i] = r->w0[i] + 0.5 * h * a[i];
    int status = move_onto_rows(o, r, lifts, h, t, w, q);
    if (status != DONE) return status;
    change = 0.0;
    for (long i = 0; n && i < NW; i++) change = fmax(change, fabs(w[i] - last[i]));
    if (n && change <= same) return DONE;
    copy(NW, w, last);
    double before[NOT_ZERO(NW)];
    copy(NW, a, before);
    evaluate(o, r, r->t0, r->q0, w, a);
    if (are_same(NW, a, before)) return DONE;
  }
  return OPEN;
}

static int rattle_step(const Options *o, Run *r, double h, double t) {
  double lifts[NOT_ZERO(NV * NG)], w[NOT_ZERO(NW)], q[NOT_ZERO(NQ)], a[NOT_ZERO(NW)], health = 1;
  keep_start(r);
  if (!r->is_forced) evaluate(o, r, r->t, r->q, r->w, r->force);
#if NG
  lift(&r->t0, r->q0, o->p, lifts, &health, r->work);
#endif
  if (health < o->least_health || r->health < o->least_health) return ILL_CONDITIONED;
  int status = kick(o, r, lifts, h, t, w, q);
  if (status != DONE) return status;
  evaluate(o, r, t, q, w, a);
  if (r->health < o->least_health) return ILL_CONDITIONED;
  for (long i = 0; i < NW; i++) r->w[i] = w[i] + 0.5 * h * a[i];
  copy(NQ, q, r->q);
  r->t = t;
  copy(NW, a, r->force);
  r->is_forced = 1.0;
#if NH
  status = place_velocity(o, r, t, r->q, r->w);
#endif
  return status;
}
#endif
