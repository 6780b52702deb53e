/* Steps of any method, and what follows each of them. */

/* How far a fixed step goes when the end is near, and the time it ends at [s]; as `clip`. */
static double step_length(double t, double dt, double end, double *after) {
  double left = end - t, ulp = nextafter(fabs(t), INFINITY) - fabs(t);
  if (fabs(left - dt) <= 1.0e-9 * dt + 4.0 * ulp) {
    *after = end;
    return dt;
  }
  *after = left < dt ? end : t + dt;
  return left < dt ? left : dt;
}

/* v+ = v + h a(q, v),   q+ = q (+) h v+ */
static int semi_implicit_euler_step(const Options *o, Run *r, double h, double t) {
  real a[NOT_ZERO(NW)], dq[NOT_ZERO(NV)];
  evaluate(o, r, r->t, r->q, r->w, a);
  if (is_ill(o, r)) return ILL_CONDITIONED;
  keep_start(r);
  for (long i = 0; i < NW; i++) r->w[i] += h * a[i];
  for (long i = 0; i < NV; i++) dq[i] = h * r->w[i];
  move(r->q0, dq, r->q, r->work);
  r->t = t;
  return DONE;
}

static int method_step(const Options *o, Run *r, double end) {
  double t, h;
#if LANES == 1
  if (o->method == RUNGE_KUTTA && o->is_adaptive) return adaptive_step(o, r, end);
#endif
  h = step_length(r->t, o->dt, end, &t);
  if (o->method == ADAMS) return adams_step(o, r, h, t);
#if IS_RATTLE
  return rattle_step(o, r, h, t);
#endif
  if (o->method == RUNGE_KUTTA) return runge_kutta_step(o, r, h, t);
  return semi_implicit_euler_step(o, r, h, t);
}

#if LANES == 1
/* What the method kept of the last step does not hold for other inputs. */
static void hold(Run *r, const double *u) {
  if (are_same(NU, u, r->u)) return;
  copy(NU, u, r->u);
  forget_history(r);
  r->is_forced = r->is_looked = 0.0;
}

/* One step, not beyond `end`, and the corrections after it. */
static int one_step(const Options *o, Run *r, double end) {
  if (!(r->t < end)) return DONE;
  int status = method_step(o, r, end);
  if (status != DONE) return status;
  r->steps += 1.0;
  if (!is_finite(r->q, r->w)) return NOT_FINITE;
  if (NZ && clamp(o, r->w + NV)) r->is_after = 0.0;
  return DONE;
}

static void state_at(const Options *o, Run *r, double t, double *q, double *w) {
  if (o->method == ADAMS)
    adams_at(o, r, t, q, w);
  else
    runge_kutta_at(o, r, t, q, w);
  clamp(o, w + NV);
}
#endif
