/* What a run is made of. Written before this file: the type `real`, sizes, and the functions of
 * the scene:
 *
 *   NQ NV NZ NU NP       sizes of q, v, z, u and p
 *   LANES                how many scenes run side by side; a real has one number of each
 *   NG NH                numbers of the rows of positions, and of all that velocities keep
 *   NQ_ALL NV_ALL        the same of all joints
 *   IS_FLAT              whether q' = v on a vector space
 *   IS_WHOLE             whether all joints are integrated
 *   IS_PROJECTED         whether every step is followed by a projection onto the rows
 *   IS_RATTLE            whether the method is RATTLE
 *   MODES                rows that give way, whose modes stand in p behind the parameters
 *   ANSWERS GAPS STAYS   margins of their forces; gaps; rows that velocities keep where they are on
 *   HAS_DEMANDS          whether margins of forces are asked for while no row is on
 *   CONTACTS             how many of them are normals of contacts with friction
 *   ASKS_ALWAYS          the same, or rates of slips
 *   WORK                 most numbers that a function of the scene keeps in between
 */
#include <float.h>
#include <string.h>

#define NW (NV + NZ)  /* velocities and internal states */
#define NR (NV + NW)  /* rates of a step in the chart, of velocities, of internal states */
#define NOT_ZERO(n) ((n) > 0 ? (n) : 1)
#define MOST_RATES 16
#define MOST_TERMS 8
#define MOST_HELD 8      /* accelerations that an Adams method uses */
#define HISTORY (LANES > 1 ? 8 : 64) /* steps after which they are moved */

enum status {
  DONE = 0,
  PAUSED = 1,           /* as many steps as were asked for */
  NOT_FINITE = 2,
  ILL_CONDITIONED = 3,  /* small pivots: another solver has to take this step */
  GUARD = 4,            /* a guard changed its sign in the last step */
  TOO_SHORT = 5,        /* no step is short enough for the tolerance */
  OPEN = 6,             /* rows do not close */
  NO_INPUTS = 7,        /* the table of inputs has come to its end */
  RENAMED = 8           /* a slip should have another name in the mode */
};

enum method { RUNGE_KUTTA, ADAMS, SEMI_IMPLICIT_EULER, RATTLE };

/* Rows of weights, zeros left out: row i has `value[begin[i]] .. value[begin[i + 1] - 1]`. */
typedef struct {
  const long *begin, *column;
  const double *value;
} Weights;

/* An explicit Runge-Kutta method: `a` has the stages, row `stages` is the step itself. */
typedef struct {
  long stages, errors, weighed, terms, all;  /* `weighed` rates in errors, `all` in dense output */
  double power;                              /* of an error in the length of a step */
  const double *c;
  Weights a, error, dense;
} Tableau;

/* Weights of accelerations, the newest first: of the step, and of powers of its part. */
typedef struct {
  long order, needed;
  Weights position, velocity, positions, velocities;
} AdamsWeights;

/* Inputs that change within steps: polynomials of the time since they began. In u, the first of
 * them holds the time of the last jump.
 */
typedef struct {
  long at, width, count, powers;
  const double *times, *coefficients;
  const long *jumps;
} Pieces;

/* What stays the same in a run. */
typedef struct {
  long method, is_adaptive, smooth;
  const Pieces *pieces;
  double dt, tolerance, closed, least_health;
  const double *lower, *upper, *sizes;  /* of internal states: bounds, errors that count as one */
  const real *p;
  Tableau tableau;                      /* of the method, or of the steps that start it */
  AdamsWeights adams;
} Options;

/* What later steps depend on, then what they do not. */
typedef struct {
  double t;  /* from where the next step starts */
  real q[NOT_ZERO(NQ)], w[NOT_ZERO(NW)];
  double t0;  /* where the last step started */
  real q0[NOT_ZERO(NQ)], w0[NOT_ZERO(NW)];
  double t1;  /* where it ended, before corrections */
  real q1[NOT_ZERO(NQ)], w1[NOT_ZERO(NW)];
  real u[NOT_ZERO(NU)];
  double h, done, is_after, is_dense;  /* rates known; the state is the end of the last step */
  double length, last_error;           /* of adaptive steps */
  double head, known, is_started, is_adams;
  double sample, is_within, steps;
  double s[NOT_ZERO(NG)], s_before[NOT_ZERO(NG)];  /* corrections of RATTLE */
  real force[NOT_ZERO(NW)];  /* rates at the state, as RATTLE left them */
  double is_forced;
  real rates[MOST_RATES][NR];
  real dense[MOST_TERMS][NR];
  real history[HISTORY + MOST_HELD][NW];
  double approach[NOT_ZERO(MODES)], is_looked;  /* rates of heights at the state, where known */
  double left[NOT_ZERO(MODES)];  /* rows that are just being left: rounding does not count there */
  double end_of_memory;
  real health;
  real pushes[NOT_ZERO(NH + MODES)];  /* multipliers of rows, as evaluated last, where some give way */
  double evaluations, interval;
  real work[NOT_ZERO(WORK)];
} Run;

static void copy(long n, const real *from, real *to) {
  if (n) memcpy(to, from, n * sizeof *to);
}

#if LANES == 1
static int are_same(long n, const double *a, const double *b) {
  return !n || !memcmp(a, b, n * sizeof *a);
}

static double largest(long n, const double *x) {
  double most = 0.0;
  for (long i = 0; i < n; i++) {
    double size = fabs(x[i]);
    if (!(size <= most)) most = size;  /* NaN stays */
    if (size != size) return size;
  }
  return most;
}

static int is_finite(const double *q, const double *w) {
  double sum = 0.0;
  for (long i = 0; i < NQ; i++) sum += q[i] * q[i];
  for (long i = 0; i < NW; i++) sum += w[i] * w[i];
  return sum <= DBL_MAX;
}
#endif

/* Whether rows are too near to dependent: where lanes are several, each is asked after a step. */
static int is_ill(const Options *o, const Run *r) {
#if LANES == 1
  return r->health < o->least_health;
#else
  return 0;
#endif
}

/* The step starts where the run stands. */
static void keep_start(Run *r) {
  r->t0 = r->t;
  copy(NQ, r->q, r->q0);
  copy(NW, r->w, r->w0);
}

/* An internal state inside its bounds. */
static real inside(const Options *o, long i, real z) {
  return real_fmin(real_fmax(z, R(o->lower[i])), R(o->upper[i]));
}

#if LANES == 1
/* The piece that has begun last at a time, of those up to the next jump. */
static long piece_at(const Pieces *p, double jump, double t) {
  long from = 0, below = p->count;
  double since = jump > t ? jump : t;
  while (below - from > 1) {
    long middle = (from + below) / 2;
    if (p->times[middle] <= since) from = middle;
    else below = middle;
  }
  long first = from;
  while (first > 0 && p->times[first] > jump) {
    if (p->jumps[first]) from = first - 1;
    first--;
  }
  return from;
}

/* The whole u at a time, from held inputs. */
static void complete_inputs(const Options *o, const double *held, double t, double *u) {
  copy(NU, held, u);
  for (long j = 0; j < o->smooth; j++) {
    const Pieces *p = o->pieces + j;
    long number = piece_at(p, held[p->at], t);
    const double *c = p->coefficients + number * p->powers * p->width;
    for (long i = 0; i < p->width; i++) {
      double value = 0.0;
      for (long k = p->powers - 1; k >= 0; k--)
        value = value * (t - p->times[number]) + c[k * p->width + i];
      u[p->at + i] = value;
    }
  }
}

#endif

/* Accelerations and rates of internal states at a state. */
static void evaluate(const Options *o, Run *r, double t, const real *q, const real *w,
                     real *out) {
  real health, z[NOT_ZERO(NZ)];
  const real *u = r->u, now = R(t);
#if LANES == 1
  double all[NOT_ZERO(NU)];
  if (NU && o->smooth) {
    complete_inputs(o, r->u, t, all);
    u = all;
  }
#endif
  for (long i = 0; i < NZ; i++) z[i] = inside(o, i, w[NV + i]);
#if MODES
  accelerate(&now, q, w, z, u, o->p, out, out + NV, &health, r->pushes, r->work);
#else
  accelerate(&now, q, w, z, u, o->p, out, out + NV, &health, r->work);
#endif
  r->evaluations += 1.0;
  r->health = real_fmin(health, r->health);
}

/* q1 = q (+) dq */
static void move(const real *q, const real *dq, real *q1, real *work) {
#if IS_FLAT
  for (long i = 0; i < NQ; i++) q1[i] = q[i] + dq[i];
#else
  integrate(q, dq, q1, work);
#endif
}

/* Rate of dq while q (+) dq moves with v. */
static void chart_rate(const real *dq, const real *v, real *out, real *work) {
#if IS_FLAT
  copy(NV, v, out);
#else
  rate(dq, v, out, work);
#endif
}

/* Internal states inside their bounds; whether one may have been outside. */
static int clamp(const Options *o, real *z) {
  int was_outside = LANES > 1;
  for (long i = 0; i < NZ; i++) {
    real within = inside(o, i, z[i]);
#if LANES == 1
    was_outside |= within != z[i];
#endif
    z[i] = within;
  }
  return was_outside;
}
