/* Sines and cosines of many numbers at once, to less than one unit in the last place.
 *
 * Source: argument reduction by pi/2 in three parts and the polynomials of fdlibm, k_sin.c, k_cos.c
 * and e_rem_pio2.c, Sun Microsystems 1993. Beyond FAR the products with the parts of pi/2 are no
 * longer exact, and the functions of the C library take over. */
#if LANES > 1
#define WIDE LANES
#else
#define WIDE 2 /* longer ones would wait for angles that were stored one by one */
#endif
#define FAR 1.0e6
#define SINES_ROOM 2 /* values are passed in a multiple of these */

typedef double wide __attribute__((vector_size(8 * WIDE)));
typedef double wide_anywhere __attribute__((vector_size(8 * WIDE), aligned(8), may_alias));
typedef long long wide_mask __attribute__((vector_size(8 * WIDE)));

static inline int any(wide_mask mask) {
  long long found = 0;
  for (int k = 0; k < WIDE; ++k) found |= mask[k];
  return found != 0;
}

static inline wide_mask is_far(wide x) { return ~((x <= FAR) & (x >= -FAR)); }

/* Of numbers that are not far. */
static inline void sines(wide x, wide *sine, wide *cosine) {
  const wide shifted = x * 0x1.45f306dc9c883p-1 + 0x1.8p+52;
  const wide_mask quarter = (wide_mask)shifted;
  const wide turns = shifted - 0x1.8p+52;
  const wide first = x - turns * 0x1.921fb544p+0;
  const wide second = turns * 0x1.0b4611a6p-34;
  const wide nearly = first - second;
  const wide third = turns * 0x1.3198a2e037073p-69 - ((first - nearly) - second);
  const wide y = nearly - third, rest = (nearly - y) - third, z = y * y, w = z * z;
  const wide odd = 8.33333333332248946124e-03 + z * -1.98412698298579493134e-04 +
                   w * (2.75573137070700676789e-06 + z * -2.50507602534068634195e-08 +
                        w * 1.58969099521155010221e-10);
  const wide s = y - ((z * (0.5 * rest - z * y * odd) - rest) - z * y * -1.66666666666666324348e-01);
  const wide even = 4.16666666666666019037e-02 + z * -1.38888888888741095749e-03 +
                    w * (2.48015872894767294178e-05 + z * -2.75573143513906633035e-07 +
                         w * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11));
  const wide half = 0.5 * z, one = 1.0 - half;
  const wide c = one + (((1.0 - one) - half) + (w * even - y * rest));
  const wide_mask swap = (quarter & 1) != 0;
  const wide_mask for_sine = (quarter & 2) << 62, for_cosine = ((quarter + 1) & 2) << 62;
  *sine = (wide)(((swap & (wide_mask)c) | (~swap & (wide_mask)s)) ^ for_sine);
  *cosine = (wide)(((swap & (wide_mask)s) | (~swap & (wide_mask)c)) ^ for_cosine);
}

static __attribute__((noinline, cold)) void sines_far(int n, const double *x, double *sine,
                                                      double *cosine) {
  for (int k = 0; k < n; ++k) {
    sine[k] = sin(x[k]);
    cosine[k] = cos(x[k]);
  }
}

/* n sines and cosines; the arrays have room for the next multiple of SINES_ROOM. */
static __attribute__((noinline)) void sines_of(int n, const real *x, real *sine, real *cosine) {
  wide_mask far = {};
  for (int k = 0; k < n; k += WIDE / LANES) {
    const wide angle = *(const wide_anywhere *)(x + k);
    wide s, c;
    sines(angle, &s, &c);
    *(wide_anywhere *)(sine + k) = s;
    *(wide_anywhere *)(cosine + k) = c;
    far |= is_far(angle);
  }
  if (__builtin_expect(any(far), 0))
    sines_far(n * LANES, (const double *)x, (double *)sine, (double *)cosine);
}

#if LANES > 1
static __attribute__((noinline)) real real_sin(real x) {
  real sine, cosine;
  sines_of(1, &x, &sine, &cosine);
  return sine;
}
static __attribute__((noinline)) real real_cos(real x) {
  real sine, cosine;
  sines_of(1, &x, &sine, &cosine);
  return cosine;
}
static __attribute__((noinline)) real real_tan(real x) {
  real sine, cosine;
  sines_of(1, &x, &sine, &cosine);
  return sine / cosine;
}
#else
EACH_OF_ONE(cos)
EACH_OF_ONE(sin)
EACH_OF_ONE(tan)
#endif
