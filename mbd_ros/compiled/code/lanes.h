/* A real is one number of each of LANES scenes. */
#include <math.h>
#include <stddef.h>

typedef double real __attribute__((vector_size(8 * LANES)));
typedef long long whole __attribute__((vector_size(8 * LANES))); /* and what comparisons give */
#define R(number) ((real){} + (number))

#define EACH_OF_ONE(name)                                                                          \
  static inline real real_##name(real x) {                                                         \
    real y;                                                                                        \
    for (int k = 0; k < LANES; ++k) y[k] = name(x[k]);                                             \
    return y;                                                                                      \
  }
#define EACH_OF_TWO(name)                                                                          \
  static inline real real_##name(real x, real y) {                                                 \
    real z;                                                                                        \
    for (int k = 0; k < LANES; ++k) z[k] = name(x[k], y[k]);                                       \
    return z;                                                                                      \
  }

static inline real kept(whole mask, real x) { return (real)(mask & (whole)x); }
static inline real one_where(whole mask) { return kept(mask, R(1.0)); }

static inline real real_less(real x, real y) { return one_where(x < y); }
static inline real real_at_most(real x, real y) { return one_where(x <= y); }
static inline real real_equal(real x, real y) { return one_where(x == y); }
static inline real real_differs(real x, real y) { return one_where(x != y); }
static inline real real_and(real x, real y) { return one_where((x != 0.0) & (y != 0.0)); }
static inline real real_or(real x, real y) { return one_where((x != 0.0) | (y != 0.0)); }
static inline real real_not(real x) { return one_where(x == 0.0); }
static inline real real_where(real x, real y) { return kept(x != 0.0, y); }
static inline real real_sign(real x) {
  return kept(x == 0.0, x) + one_where(x > 0.0) - one_where(x < 0.0);
}
static inline real chosen(whole mask, real x, real y) {
  return (real)((mask & (whole)x) | (~mask & (whole)y));
}
/* As in C: of a number and none, the number. */
static inline real real_fmin(real x, real y) { return chosen((x < y) | (y != y), x, y); }
static inline real real_fmax(real x, real y) { return chosen((x > y) | (y != y), x, y); }
