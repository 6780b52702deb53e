/* The nearest state on the rows, in the mass metric; source: E. Eich, SIAM J. Numer. Anal. 30,
 * 1993. A step of Newton's method leaves a gap of second order in it, so that one as small as
 * `QUADRATIC` is the last.
 */
#if IS_PROJECTED || IS_RATTLE
#define CORRECTIONS 12
#define VELOCITY_CORRECTIONS 3
#define LANDED 1.0e-13
#define ON_MANIFOLD 1.0e-12
#define QUADRATIC 1.0e-8
#define MOST_OPEN 1.0e-6
#define MOST_STEP 0.5
#endif

#if LANES == 1 && (IS_PROJECTED || IS_RATTLE)
#if IS_PROJECTED
static int place_configuration(const Options *o, Run *r, double t, double *q) {
#if NG
  double dq[NOT_ZERO(NV)], g[NG], health, there[NOT_ZERO(NQ)], open = 0.0;
  for (long i = 0; i < CORRECTIONS; i++) {
    place(&t, q, o->p, dq, g, &health, r->work);
    open = largest(NG, g);
    double step = largest(NV, dq);
    if (open <= LANDED) return DONE;
    if (health < o->least_health) return ILL_CONDITIONED;
    if (!(step <= MOST_STEP)) return OPEN;
    move(q, dq, there, r->work);
    copy(NQ, there, q);
    if (step <= QUADRATIC) return DONE;
  }
  return open <= MOST_OPEN ? DONE : OPEN;
#else
  return DONE;
#endif
}
#endif

static int place_velocity(const Options *o, Run *r, double t, const double *q, double *v) {
  double dv[NOT_ZERO(NV)], rates[NOT_ZERO(NH)];
  for (long i = 0; i < VELOCITY_CORRECTIONS; i++) {
    settle(&t, q, v, o->p, dv, rates, r->work);
    double speed = 1.0 + largest(NV, v);
    if (largest(NH, rates) <= ON_MANIFOLD * speed) break;
    for (long k = 0; k < NV; k++) v[k] += dv[k];
    if (largest(NV, dv) <= 1.0e-4 * speed) break;
  }
  return DONE;
}

#if IS_PROJECTED
static int project(const Options *o, Run *r, double t, double *q, double *w) {
  int status = place_configuration(o, r, t, q);
  return status == DONE ? place_velocity(o, r, t, q, w) : status;
}
#endif
#endif
