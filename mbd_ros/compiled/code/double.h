/* A real is one number. */
#include <math.h>
#include <stddef.h>

typedef double real;
#define R(number) (number)

#define EACH_OF_ONE(name)                                                                          \
  static inline real real_##name(real x) { return name(x); }
#define EACH_OF_TWO(name)                                                                          \
  static inline real real_##name(real x, real y) { return name(x, y); }

static inline real real_less(real x, real y) { return x < y; }
static inline real real_at_most(real x, real y) { return x <= y; }
static inline real real_equal(real x, real y) { return x == y; }
static inline real real_differs(real x, real y) { return x != y; }
static inline real real_and(real x, real y) { return x != 0 && y != 0; }
static inline real real_or(real x, real y) { return x != 0 || y != 0; }
static inline real real_not(real x) { return x == 0; }
static inline real real_where(real x, real y) { return x != 0 ? y : 0.0; }
static inline real real_sign(real x) { return x < 0 ? -1.0 : x > 0 ? 1.0 : x; }
/* As in C: of a number and none, the number. */
static inline real real_fmin(real x, real y) { return x < y || y != y ? x : y; }
static inline real real_fmax(real x, real y) { return x > y || y != y ? x : y; }
