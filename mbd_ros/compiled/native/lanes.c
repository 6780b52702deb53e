/* What Python calls where a real is one number of each of LANES scenes: runs side by side, in steps
 * that all of them share.
 *
 * A lane that is no longer finite, or whose rows come near to dependent, keeps what it has and goes
 * on from its start, so that the others lose nothing by it.
 */
static whole is_finite_in(const real *q, const real *w) {
  real sum = R(0.0);
  for (long i = 0; i < NQ; i++) sum += q[i] * q[i];
  for (long i = 0; i < NW; i++) sum += w[i] * w[i];
  return sum <= R(DBL_MAX);
}

#if IS_PROJECTED
/* Where all of some numbers are that small. */
static whole are_small(long n, const real *x, real most) {
  whole found = ~(whole){};
  for (long i = 0; i < n; i++) found &= (x[i] <= most) & (x[i] >= -most);
  return found;
}

/* As `place_configuration`; where it does not get to the rows. */
static whole place_lanes(const Options *o, Run *r, double t, real *q) {
#if NG
  real dq[NOT_ZERO(NV)], g[NG], health, there[NOT_ZERO(NQ)];
  const real now = R(t);
  whole open = ~(whole){}, wrong = {};
  for (long i = 0; i < CORRECTIONS; i++) {
    place(&now, q, o->p, dq, g, &health, r->work);
    open &= ~are_small(NG, g, R(LANDED));
    wrong |= open & ~((health >= R(o->least_health)) & are_small(NV, dq, R(MOST_STEP)));
    open &= ~wrong;
    if (!any(open)) break;
    move(q, dq, there, r->work);
    for (long k = 0; k < NQ; k++) q[k] = chosen(open, there[k], q[k]);
    open &= ~are_small(NV, dq, R(QUADRATIC));
  }
  return wrong | open;
#else
  return (whole){};
#endif
}

/* As `place_velocity`. */
static void settle_lanes(const Options *o, Run *r, double t, const real *q, real *v) {
  real dv[NOT_ZERO(NV)], rates[NOT_ZERO(NH)];
  const real now = R(t);
  whole open = ~(whole){};
  for (long i = 0; i < VELOCITY_CORRECTIONS && any(open); i++) {
    settle(&now, q, v, o->p, dv, rates, r->work);
    real speed = R(1.0);
    for (long k = 0; k < NV; k++) speed = real_fmax(speed, 1.0 + real_fabs(v[k]));
    open &= ~are_small(NH, rates, ON_MANIFOLD * speed);
    for (long k = 0; k < NV; k++) v[k] += kept(open, dv[k]);
    open &= ~are_small(NV, dv, 1.0e-4 * speed);
  }
}
#endif

/* Steps until a time [s]; where something went wrong. */
static whole step_lanes(const Options *o, Run *r, double end) {
  whole wrong = {};
  while (r->t < end) {
    r->health = R(1.0);
    method_step(o, r, end);
    if (NZ && clamp(o, r->w + NV)) r->is_after = 0.0;
#if IS_PROJECTED
    r->is_after = 0.0;
    wrong |= place_lanes(o, r, r->t, r->q);
    settle_lanes(o, r, r->t, r->q, r->w);
#endif
    wrong |= ~is_finite_in(r->q, r->w) | (r->health < R(o->least_health));
  }
  return wrong;
}

/* A row of each lane: time, positions and velocities of all joints, internal states. */
static void emit_lanes(Run *r, long lanes, long width, long apart, double *out) {
  const real *q = r->q, *v = r->w;
#if !IS_WHOLE
  real all[NOT_ZERO(NQ_ALL)], rates[NOT_ZERO(NV_ALL)];
  const real now = R(r->t);
  expand(&now, q, v, all, rates, r->work);
  q = all, v = rates;
#endif
  for (long k = 0; k < lanes; k++, out += apart) {
    out[0] = r->t;
    for (long i = 0; i < NQ_ALL; i++) out[1 + i] = q[i][k];
    for (long i = 0; i < NV_ALL; i++) out[1 + NQ_ALL + i] = v[i][k];
    for (long i = 0; i < NZ; i++) out[1 + NQ_ALL + NV_ALL + i] = r->w[NV + i][k];
  }
}

/* The lanes start from states in rows, the last row again where there are fewer. */
static void begin_lanes(Run *r, long lanes, const double *y, double t, const double *p,
                        real *of_lanes) {
  for (long k = 0; k < LANES; k++) {
    long row = k < lanes ? k : lanes - 1;
    const double *x = y + row * (NQ + NW), *own = p + row * NP;
    for (long i = 0; i < NQ; i++) r->q[i][k] = x[i];
    for (long i = 0; i < NW; i++) r->w[i][k] = x[NQ + i];
    for (long i = 0; i < NP; i++) of_lanes[i][k] = own[i];
  }
  forget_history(r);
  r->done = r->is_dense = r->is_forced = r->is_adams = 0.0;
  r->t = t;
}

/* Numbers in a run. */
EXPORT long size_of_run(void) { return sizeof(Run) / sizeof(double); }

/* Samples of n runs at times that all share, the first one of them that of the start: a row a
 * sample in `out`, run after run. `known` says how many samples of each are right.
 */
EXPORT void many(const Options *given, Run *r, long n, const double *y, const double *p,
                 const double *u, const double *times, long count, double *out, long *known) {
  Options o = *given;
  real own[NOT_ZERO(NP)], q[NOT_ZERO(NQ)], w[NOT_ZERO(NW)];
  const long width = 1 + NQ_ALL + NV_ALL + NZ;
  o.p = own;
  for (long i = 0; i < NU; i++) r->u[i] = R(u[i]);
  for (long first = 0; first < n; first += LANES) {
    long lanes = n - first < LANES ? n - first : LANES;
    double *rows = out + first * count * width;
    begin_lanes(r, lanes, y + first * (NQ + NW), times[0], p + first * NP, own);
    copy(NQ, r->q, q);
    copy(NW, r->w, w);
    whole alive = ~(whole){};
    for (long k = 0; k < lanes; k++) known[first + k] = count;
    emit_lanes(r, lanes, width, count * width, rows);
    for (long i = 1; i < count && any(alive); i++) {
      whole wrong = step_lanes(&o, r, times[i]);
      if (any(wrong)) {
        for (long k = 0; k < lanes; k++)
          if (wrong[k] && alive[k]) known[first + k] = i;
        alive &= ~wrong;
        for (long k = 0; k < NQ; k++) r->q[k] = chosen(wrong, q[k], r->q[k]);
        for (long k = 0; k < NW; k++) r->w[k] = chosen(wrong, w[k], r->w[k]);
        r->is_after = 0.0;
      }
      emit_lanes(r, lanes, width, count * width, rows + i * width);
    }
  }
}
