/* The first event of the last step where that is a gap which closes; as `StepEvents`. */
#if CONTACTS
#define WIDTH 1.0e-4   /* of a bracket: for a slope */
#define MOST_PARTS 200
#define SHRINK 0.125   /* of the step, when looking for a place off a gap that was just left */

/* A margin by the length of the step, and where to look at it. */
typedef struct {
  const Options *o;
  Run *r;
  long which;
} Margin;

typedef struct {
  double x, f;
} Point;

typedef double Look(const Margin *m, double h);

static double after_step(const Margin *m, double h) {
  return margin_again(m->o, m->r, h, m->r->t0 + h, m->which);
}

static double inside_step(const Margin *m, double h) {
  return margin_within(m->o, m->r, m->r->t0 + h, m->which);
}

/* As `event_location._interpolated`. */
static double interpolated(Point a, Point b, Point c) {
  if (b.f == c.f || a.f == b.f || a.f == c.f) return 0.5;
  double xi = (a.x - b.x) / (c.x - b.x), phi = (a.f - b.f) / (c.f - b.f);
  if (!(1.0 - sqrt(1.0 - xi) < phi && phi < sqrt(xi))) return 0.5;
  return a.f / (b.f - a.f) * c.f / (b.f - c.f)
         + (c.x - a.x) / (b.x - a.x) * a.f / (c.f - a.f) * b.f / (c.f - b.f);
}

/* As `event_location.sign_change`; no number where a margin is none. */
static double sign_change(Look *look_at, const Margin *m, Point near, Point far, double width) {
  Point a = far, b = near, c, best = near;
  double part = 0.5;
  for (long i = 0; i < MOST_PARTS; i++) {
    Point here = {a.x + part * (b.x - a.x), 0.0};
    here.f = look_at(m, here.x);
    if (here.f != here.f) return NAN;
    if ((here.f > 0.0) == (a.f > 0.0)) c = a;
    else c = b, b = a;
    a = here;
    best = fabs(a.f) < fabs(b.f) ? a : b;
    double least = fmax(2.0 * spacing(fabs(best.x)), width);
    double limit = b.x != a.x ? least / fabs(b.x - a.x) : 1.0;
    if (best.f == 0.0 || limit > 0.5) return best.x;
    part = fmin(fmax(interpolated(a, b, c), limit), 1.0 - limit);
  }
  return best.x;
}

/* As `event_location.narrowed`, by the dense output of the step. */
static void narrow(const Margin *m, Point *near, Point *far) {
  Point start = {near->x, inside_step(m, near->x)}, end = {far->x, inside_step(m, far->x)};
  if (!(start.f > 0.0 && 0.0 > end.f)) return;
  double guess = sign_change(inside_step, m, start, end, 0.0), width = WIDTH * (far->x - near->x);
  double low = fmax(guess - width, near->x), high = fmin(guess + width, far->x);
  double slope = (inside_step(m, high) - inside_step(m, low)) / (high - low);
  Point first = {guess, after_step(m, guess)};
  if (slope == 0.0 || first.f == 0.0) return;
  Point second = {guess - 2.0 * first.f / slope, 0.0};
  if (!(near->x < second.x && second.x < far->x)) return;
  second.f = after_step(m, second.x);
  if ((first.f > 0.0) == (second.f > 0.0)) return;
  *near = first.f > 0.0 ? first : second;
  *far = first.f > 0.0 ? second : first;
}

/* Where a margin is positive that may be none at the start; its value is none where that is
 * nowhere.
 */
static Point beyond(const Margin *m, double h) {
  Run *r = m->r;
  Point near = {0.0, 0.0};
  if (!r->left[m->which]) near.f = margin_at(m->o, r, r->t0, r->q0, r->w0, m->which);
  else
    for (double x = SHRINK * h; !(near.f > 0.0) && x > 4.0 * spacing(fabs(r->t0)); x *= SHRINK)
      near.x = x, near.f = after_step(m, x);
  return near;
}

/* Length of the step after which a margin is zero; no number where Python has to find it. */
static double length_until(const Margin *m, double h) {
  Run *r = m->r;
  Point near = beyond(m, h), far = {h, after_step(m, h)};
  if (!(near.f > 0.0) || far.f >= 0.0) return near.f > 0.0 ? h : NAN;
  narrow(m, &near, &far);
  return sign_change(after_step, m, near, far, spacing(fabs(r->t0)));
}

/* Number of the most negative margin, -1 where none is; MODES where it is one of forces. */
static long latest(const Options *o, Run *r, double t, const double *q, const double *w,
                   const char *done, double *rates) {
  double margins[MODES], spans[MODES], more[MODES], of_forces[NOT_ZERO(ANSWERS)], names, length;
  double slack = rounding(q, w), lowest = 0.0;
  long found = -1;
  heights(&t, q, w, o->p, margins, rates, spans, &names, r->work);
  for (long i = 0; i < MODES; i++) {
    int counts = !done[i] && !(r->left[i] && margins[i] >= -slack);
    if (counts && margins[i] < lowest) lowest = margins[i], found = i;
  }
  if (!ASKS_ALWAYS && !has_on(o)) return found;
  ask_forces(o, r, t, q, w, of_forces, more, &length);
  for (long i = 0; i < ANSWERS; i++)
    if (!(of_forces[i] >= 0.0)) found = MODES;
  for (long i = 0; i < MODES; i++) rates[i] += more[i];
  return found;
}

/* Whether bodies may have met and parted before the end of the step as it is now. */
static int may_have_met(const Options *o, Run *r, const double *last) {
  double q[NOT_ZERO(NQ)], w[NOT_ZERO(NW)], rates[MODES], slack = rounding(r->q0, r->w0);
  char none[MODES] = {0};
  if (HAS_DEMANDS || has_on(o)) {
    double middle = r->t0 + 0.5 * (r->t - r->t0);
    state_at(o, r, middle, q, w);
    if (latest(o, r, middle, q, w, none, rates) >= 0) return 1;
  }
  latest(o, r, r->t0, r->q0, r->w0, none, rates);
  for (long i = 0; i < MODES; i++)
    if (WAYS(o)[i] != 0.0 && !r->left[i] && !(rates[i] >= -slack) && !(last[i] <= 0.0)) return 1;
  return 0;
}

static double search(const Options *o, Run *r, const char *is_gap, long *which) {
  double out[NOT_ZERO(NQ) + NOT_ZERO(NW)], rates[MODES], h = r->t - r->t0;
  char done[MODES] = {0};
  long next = latest(o, r, r->t, r->q, r->w, done, rates);
  if (next < 0) h = INFINITY;
  while (next >= 0) {
    if (next == MODES || !is_gap[next]) return NAN;
    Margin margin = {o, r, next};
    done[next] = 1, *which = next;
    h = length_until(&margin, h);
    if (!(h > 4.0 * spacing(fabs(r->t0)))) return NAN;
    if (again(o, r, h, r->t0 + h, out) != DONE) return NAN;
    next = latest(o, r, r->t, r->q, r->w, done, rates);
  }
  return may_have_met(o, r, rates) ? NAN : h;
}
#endif

/* Length until the first gap closes in the last step, and its row; infinite where nothing happens;
 * no number where another event may come first, or Python has to look for any reason. The step is
 * as long as it was then.
 */
EXPORT double first_event(const Options *o, Run *r, const char *is_gap, long *which) {
  double h = NAN;
#if CONTACTS
  double out[NOT_ZERO(NQ) + NOT_ZERO(NW)], end = r->t;
  h = search(o, r, is_gap, which);
  if (h != h && r->t != end) again(o, r, end - r->t0, end, out);
#endif
  return h;
}
