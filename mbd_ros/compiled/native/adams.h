/* Adams-Bashforth steps; steps of the starter until enough accelerations are known.
 *
 *   v+ = v + h sum_j b_j a_(n-j),   q+ = q + h v + h^2 sum_j d_j a_(n-j)
 *
 * Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, 1993, III.1, III.10.
 */

/* A place before the newest acceleration for the next one. */
static real *next_acceleration(const Options *o, Run *r) {
  if (r->head == 0.0) {
    memcpy(r->history[HISTORY], r->history[0], o->adams.order * sizeof r->history[0]);
    r->head = HISTORY;
  }
  r->head -= 1.0;
  return r->history[(long)r->head];
}

/* Forget the accelerations of earlier steps. */
static void forget_history(Run *r) {
  r->head = HISTORY, r->known = 0.0, r->is_after = 0.0;
}

static int start_adams(const Options *o, Run *r, double h, double t) {
  int is_whole = h == o->dt;
  if (!is_whole) forget_history(r);
  r->is_adams = 0.0;
  int status = runge_kutta_step(o, r, h, t);
  if (status != DONE) return status;
  if (is_whole) {
    copy(NW, r->rates[0] + NV, next_acceleration(o, r));
    r->known += 1.0;
  } else {
    r->is_after = 0.0;
  }
  return DONE;
}

/* One step of length h [s] that ends at t [s]. */
static int adams_step(const Options *o, Run *r, double h, double t) {
  if (h != o->dt || r->known < o->adams.needed) return start_adams(o, r, h, t);
  real *a = next_acceleration(o, r), dq[NW], dv[NW];
  evaluate(o, r, r->t, r->q, r->w, a);
  if (is_ill(o, r)) return ILL_CONDITIONED;
  const real(*rows)[NW] = (const real(*)[NW])a;
  sum_history(o->adams.position, 0, 1.0, rows, dq);
  sum_history(o->adams.velocity, 0, 1.0, rows, dv);
  keep_start(r);
  for (long i = 0; i < NQ && i < NV; i++) r->q[i] = r->q0[i] + (h * r->w0[i] + dq[i]);
  for (long i = 0; i < NW; i++) r->w[i] = r->w0[i] + dv[i];
  copy(NQ, r->q, r->q1);
  copy(NW, r->w, r->w1);
  r->h = h, r->t = r->t1 = t, r->is_adams = 1.0, r->is_dense = r->is_after = 0.0;
  return DONE;
}

/* State inside the last step, of the order of the method. */
static void adams_at(const Options *o, Run *r, double t, real *q, real *w) {
  if (!r->is_adams || t == r->t1) {
    runge_kutta_at(o, r, t, q, w);
    return;
  }
  long order = o->adams.order;
  const real(*rows)[NW] = (const real(*)[NW])r->history[(long)r->head];
  if (!r->is_dense) {
    for (long i = 0; i < order; i++) {
      real d[NW];
      sum_history(o->adams.positions, i, r->h * r->h, rows, d);
      copy(NV, d, r->dense[i]);
      sum_history(o->adams.velocities, i, r->h, rows, r->dense[i] + NV);
    }
    r->is_dense = 1.0;
  }
  double theta = (t - r->t0) / r->h, parts[MOST_TERMS];
  real d[NR];
  for (long i = 0; i < order; i++) parts[i] = theta;
  sum_nested(order, parts, (const real (*)[NR])r->dense, d);
  for (long i = 0; i < NQ && i < NV; i++)
    q[i] = r->q0[i] + theta * (r->h * r->w0[i] + d[i]);
  for (long i = 0; i < NW; i++) w[i] = r->w0[i] + d[NV + i];
}
