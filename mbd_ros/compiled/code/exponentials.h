/* Exponentials and logarithms of vectors, to about one unit in the last place.
 *
 * Source: exp by 2^k exp(r) with |r| <= log(2)/2 and the series of exp(r) - 1; log as in fdlibm,
 * e_log.c, Sun Microsystems 1993. */
#if LANES > 1
static inline real real_of(whole k) { /* for |k| < 2^51 */
  return (real)(k + 0x4338000000000000) - 0x1.8p+52;
}
static inline real power_of_two(whole k) { return (real)((k + 1023) << 52); }

/* r and k of x = k log(2) + r, and exp(r) - 1. */
static inline real near_one(real x, whole *k) {
  const real shifted = x * 0x1.71547652b82fep+0 + 0x1.8p+52, n = shifted - 0x1.8p+52;
  const real r = (x - n * 0x1.62e42feep-1) - n * 0x1.a39ef35793c76p-33;
  *k = (whole)shifted - 0x4338000000000000;
  static const double terms[] = {1.0 / 6227020800, 1.0 / 479001600, 1.0 / 39916800, 1.0 / 3628800,
                                 1.0 / 362880,     1.0 / 40320,     1.0 / 5040,     1.0 / 720,
                                 1.0 / 120,        1.0 / 24,        1.0 / 6};
  real sum = R(0.0);
  for (int i = 0; i < 11; ++i) sum = sum * r + terms[i];
  return r + r * r * (0.5 + r * sum);
}

static inline real held(real x, double low, double high) {
  return chosen(x > high, R(high), chosen(x < low, R(low), x));
}

static __attribute__((noinline)) real real_exp(real x) {
  whole k;
  const real p = near_one(held(x, -760.0, 720.0), &k);
  const whole half = k >> 1;
  return (1.0 + p) * power_of_two(half) * power_of_two(k - half);
}

static __attribute__((noinline)) real real_tanh(real x) {
  whole k;
  const real size = (real)((whole)x & 0x7fffffffffffffff);
  const real p = near_one(held(2.0 * size, 0.0, 100.0), &k), scale = power_of_two(k);
  const real t = scale * p + (scale - 1.0); /* exp(2 |x|) - 1 */
  return (real)((whole)(t / (t + 2.0)) | ((whole)x & ~0x7fffffffffffffff));
}

static __attribute__((noinline)) real real_log(real x) {
  const whole tiny = x < 0x1p-1022;
  const whole bits = (whole)chosen(tiny, x * 0x1p+54, x) + (0x3ff0000000000000 - 0x3fe6a09e667f3bcd);
  const real k = real_of((bits >> 52) - 1023) - kept(tiny, R(54.0));
  const real f = (real)((bits & 0x000fffffffffffff) + 0x3fe6a09e667f3bcd) - 1.0;
  const real s = f / (2.0 + f), z = s * s, w = z * z, half = 0.5 * f * f;
  const real even = w * (3.999999999940941908e-01 +
                         w * (2.222219843214978396e-01 + w * 1.531383769920937332e-01));
  const real odd = z * (6.666666666666735130e-01 +
                        w * (2.857142874366239149e-01 +
                             w * (1.818357216161805012e-01 + w * 1.479819860511658591e-01)));
  const real log = k * 0x1.62e42feep-1 -
                   ((half - (s * (half + even + odd) + k * 0x1.a39ef35793c76p-33)) - f);
  const real at_ends = chosen(x == 0.0, R(-INFINITY), chosen(x < 0.0, R(NAN), x));
  return chosen((x > 0.0) & (x < INFINITY), log, at_ends);
}
#else
EACH_OF_ONE(exp)
EACH_OF_ONE(log)
EACH_OF_ONE(tanh)
#endif
