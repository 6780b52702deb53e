/* What Python calls: runs from sample to sample, and single steps. */

/* When samples are due, and how finely times are told apart. */
typedef struct {
  double origin, dt, last, resolution, slack;
  long end, ends_at_samples;
} Times;

/* Held inputs by interval: `values` has a row of NU, in use until the time in `until`. */
typedef struct {
  long count;
  const double *until, *values;
} Inputs;

enum field {
  SIZE, MEMORY, T, Q, W, T0, Q0, W0, SAMPLE, IS_WITHIN, STEPS, LENGTH, INTERVAL, HEALTH,
  EVALUATIONS, LEFT, U, ROW
};

#define PLACE(field) ((long)(offsetof(Run, field) / sizeof(double)))
#define NQ_NV_ALL (NQ_ALL + NV_ALL)

/* Where the numbers of a run stand, counted in numbers. */
EXPORT long place_of(long field) {
  switch (field) {
    case SIZE: return sizeof(Run) / sizeof(double);
    case MEMORY: return PLACE(end_of_memory);
    case T: return PLACE(t);
    case Q: return PLACE(q);
    case W: return PLACE(w);
    case T0: return PLACE(t0);
    case Q0: return PLACE(q0);
    case W0: return PLACE(w0);
    case SAMPLE: return PLACE(sample);
    case IS_WITHIN: return PLACE(is_within);
    case STEPS: return PLACE(steps);
    case LENGTH: return PLACE(length);
    case INTERVAL: return PLACE(interval);
    case HEALTH: return PLACE(health);
    case EVALUATIONS: return PLACE(evaluations);
    case LEFT: return PLACE(left);
    case U: return PLACE(u);
    default: return 1 + NQ_NV_ALL + NZ;
  }
}

/* Forget everything that was kept from earlier steps. */
EXPORT void restart(Run *r) {
  forget_history(r);
  r->done = r->is_dense = r->is_forced = r->length = r->is_adams = 0.0;
  r->is_looked = 0.0;
  r->last_error = SMALL_ERROR;
  memset(r->s, 0, sizeof r->s);
  memset(r->s_before, 0, sizeof r->s_before);
}

/* Go on from the last state, corrected. */
EXPORT void touch(Run *r) {
  r->is_after = 0.0;
}

/* Go on from another state than that of the last step. */
EXPORT void leave(Run *r) {
  forget_history(r);
  r->is_forced = r->is_looked = 0.0;
}

/* Time that the step after a sample should not pass, so that samples are dt apart. */
static double step_end(const Options *o, const Run *r, const Times *s, double now, double due) {
  double here = s->origin + r->sample * s->dt, late = fabs(here - r->t);
  int is_rounded = late > 0.2 * s->slack || !o->is_adaptive;
  int is_off = now > here + s->slack;
  int is_next = (is_rounded && late < 1.0e3 * s->slack) || is_off;
  return is_next || s->ends_at_samples ? due : s->last;
}

static int emit(const Options *o, Run *r, double t, const double *q, const double *w,
                double *out) {
  *out++ = t;
#if IS_WHOLE
  copy(NQ, q, out);
  copy(NV, w, out + NQ);
#else
  expand(&t, q, w, out, out + NQ_ALL, r->work);
#endif
  copy(NZ, w + NV, out + NQ_NV_ALL);
  return DONE;
}

static int emit_within(const Options *o, Run *r, double t, double *out) {
  double q[NOT_ZERO(NQ)], w[NOT_ZERO(NW)];
  state_at(o, r, t, q, w);
  int status = correct_at(o, r, t, q, w);
  return status == DONE ? emit(o, r, t, q, w, out) : status;
}

static double due_time(const Times *s, double sample) {
  return fmin(s->origin + sample * s->dt, s->last);
}

/* Samples that stand in the last step; the run stops within where `most` are written. */
static int samples_within(const Options *o, Run *r, const Times *s, long most, long *count,
                          double *out) {
  double due = due_time(s, r->sample + 1.0);
  r->is_within = 1.0;
  for (; r->sample < s->end && due < r->t - s->slack; due = due_time(s, r->sample + 1.0)) {
    if (*count == most) return DONE;
    int status = emit_within(o, r, due, out + *count * (1 + NQ_NV_ALL + NZ));
    if (status != DONE) return status;
    r->sample += 1.0, *count += 1;
  }
  r->is_within = 0.0;
  return DONE;
}

/* Write the samples after the newest one, until `most` are written or taken steps are enough.
 * `now` is when the inputs jumped last.
 */
EXPORT int samples(const Options *o, Run *r, const Times *s, const Inputs *in, double now, long steps,
            long most, long *written, double *out) {
  double enough = r->steps + steps;
  int status = DONE;
  r->interval = *written = 0, r->health = 1.0;
  hold(r, in->values);
  while (r->sample < s->end && *written < most) {
    double due = due_time(s, r->sample + 1.0), until = in->until[(long)r->interval];
    if (!r->is_within) {
      if (r->steps >= enough) return PAUSED;
      status = step_in_mode(o, r, fmin(step_end(o, r, s, now, due), until));
      if (status != DONE) return status;
      double off = fabs(r->t - due);
      if (off > 0.0 && off <= s->resolution && s->resolution == s->slack)
        r->t = due, r->is_after = 0.0;
    }
    status = samples_within(o, r, s, most, written, out);
    if (status != DONE || r->is_within) return status;
    status = correct(o, r);
    if (status != DONE) return status;
    if (r->t >= until) {
      now = until, r->interval += 1.0;
      if ((long)r->interval < in->count) hold(r, in->values + (long)r->interval * NU);
    }
    due = due_time(s, r->sample + 1.0);
    if (r->sample < s->end && due <= r->t + s->slack) {
      emit(o, r, r->t, r->q, r->w, out + *written * (1 + NQ_NV_ALL + NZ));
      r->sample += 1.0, *written += 1;
    }
    if ((long)r->interval >= in->count) return NO_INPUTS;
  }
  return status;
}

/* A whole run from a state on: time, q, v, z. */
EXPORT int sample_from(const Options *o, Run *r, const double *x, const Times *s, const Inputs *in,
                       long steps, long *written, double *out) {
  restart(r);
  r->t = x[0];
  copy(NQ, x + 1, r->q);
  copy(NW, x + 1 + NQ, r->w);
  r->sample = r->is_within = 0.0;
  return samples(o, r, s, in, x[0], steps, s->end, written, out);
}

/* Steps until a time [s], at most so many. */
EXPORT int advance(const Options *o, Run *r, const double *u, double end, long most) {
  double enough = r->steps + most;
  int status = DONE;
  r->health = 1.0;
  hold(r, u);
  while (r->t < end && r->steps < enough) {
    status = step_in_mode(o, r, end);
    if (status == DONE) status = correct(o, r);
    if (status != DONE) return status;
  }
  return r->t < end ? PAUSED : DONE;
}

/* One step that nothing looks at or corrects. */
EXPORT int step_alone(const Options *o, Run *r, const double *u, double end) {
  r->health = 1.0, r->is_looked = 0.0;
  hold(r, u);
  return one_step(o, r, end);
}

/* State inside the last step as its dense output has it, [q; v; z]. */
EXPORT int state_within(const Options *o, Run *r, double t, double *out) {
  state_at(o, r, t, out, out + NQ);
  return DONE;
}

/* The last step once more with another length; `out` is [q; v; z] there. */
EXPORT int again(const Options *o, Run *r, double h, double t, double *out) {
  r->health = 1.0;
  if (r->is_adams || r->done < 1.0) {
    r->t = r->t0, r->done = r->is_after = 0.0;
    copy(NQ, r->q0, r->q);
    copy(NW, r->w0, r->w);
    begin_step(o, r);
  }
  if (o->method == ADAMS) forget_history(r), r->is_adams = 0.0;
  advance_step(o, r, h, t);
  if (r->health < o->least_health) return ILL_CONDITIONED;
  accept_step(r);
  copy(NQ, r->q, out);
  clamp(o, r->w + NV);
  copy(NW, r->w, out + NQ);
  return DONE;
}

/* A margin of the mode at a state: number `which` of heights, then of forces. */
static double margin_at(const Options *o, Run *r, double t, const double *q, const double *w,
                        long which) {
#if MODES
  double margins[MODES], rates[MODES], spans[MODES], names, of_forces[NOT_ZERO(ANSWERS)], length;
  if (which >= MODES) {
    ask_forces(o, r, t, q, w, of_forces, rates, &length);
    return of_forces[which - MODES];
  }
  heights(&t, q, w, o->p, margins, rates, spans, &names, r->work);
  return margins[which];
#else
  return 0.0;
#endif
}

/* A margin of the mode inside the last step. */
EXPORT double margin_within(const Options *o, Run *r, double t, long which) {
  double q[NOT_ZERO(NQ)], w[NOT_ZERO(NW)];
  state_at(o, r, t, q, w);
  return margin_at(o, r, t, q, w, which);
}

/* A margin after the last step, taken once more with another length; no number where it fails. */
EXPORT double margin_again(const Options *o, Run *r, double h, double t, long which) {
  double out[NOT_ZERO(NQ) + NOT_ZERO(NW)];
  if (again(o, r, h, t, out) != DONE) return NAN;
  return margin_at(o, r, t, out, out + NQ, which);
}

/* State inside the last step, corrected, [q; v; z]. */
EXPORT int interpolate(const Options *o, Run *r, double t, double *out) {
  state_at(o, r, t, out, out + NQ);
  return correct_at(o, r, t, out, out + NQ);
}

/* Accelerations and rates of internal states, and the health of the rows. */
EXPORT double evaluate_at(const Options *o, Run *r, double t, const double *x, const double *u,
                   double *out) {
  r->health = 1.0;
  copy(NU, u, r->u);
  evaluate(o, r, t, x, x + NQ, out);
  r->evaluations -= 1.0;  /* those of runs count */
  return r->health;
}
