/* Andrews' squeezer written by hand: closed forms of M, f and G, a dense LU of all 13 unknowns.
 *
 * Source: Hairer, Wanner, Solving Ordinary Differential Equations II, 1996, VII.7; Test Set for
 * IVP Solvers. The angles are beta, Theta, gamma, Phi, delta, Omega, epsilon.
 */
#define ANDREWS_N 13

static const double m1 = 0.04325, m2 = 0.00365, m3 = 0.02373, m4 = 0.00706, m5 = 0.07050,
                    m6 = 0.00706, m7 = 0.05498;
static const double i1 = 2.194e-6, i2 = 4.410e-7, i3 = 5.255e-6, i4 = 5.667e-7, i5 = 1.169e-5,
                    i6 = 5.667e-7, i7 = 1.912e-5;
static const double xb = -0.03635, yb = 0.03273, xc = 0.014, yc = 0.072, c0 = 4530.0,
                    l0 = 0.07785, mom = 0.033;
static const double d = 0.028, da = 0.0115, e = 0.02, ea = 0.01421, rr = 0.007, ra = 0.00092,
                    ss = 0.035, sa = 0.01874, sb = 0.01043, sc = 0.018, sd = 0.02, ta = 0.02308,
                    tb = 0.00916, lu = 0.04, ua = 0.01228, ub = 0.00449, zf = 0.02, zt = 0.04,
                    fa = 0.01421;

/* Dense LU with row exchanges, in place; b becomes the solution. */
static void solve_dense(double A[ANDREWS_N][ANDREWS_N], double *b) {
  for (int k = 0; k < ANDREWS_N; k++) {
    int best = k;
    for (int i = k + 1; i < ANDREWS_N; i++)
      if (fabs(A[i][k]) > fabs(A[best][k])) best = i;
    if (best != k) {
      for (int j = 0; j < ANDREWS_N; j++) {
        double kept = A[k][j];
        A[k][j] = A[best][j], A[best][j] = kept;
      }
      double kept = b[k];
      b[k] = b[best], b[best] = kept;
    }
    double inverse = 1.0 / A[k][k];
    for (int i = k + 1; i < ANDREWS_N; i++) {
      double share = A[i][k] * inverse;
      if (share == 0.0) continue;
      for (int j = k + 1; j < ANDREWS_N; j++) A[i][j] -= share * A[k][j];
      b[i] -= share * b[k];
    }
  }
  for (int i = ANDREWS_N - 1; i >= 0; i--) {
    for (int j = i + 1; j < ANDREWS_N; j++) b[i] -= A[i][j] * b[j];
    b[i] /= A[i][i];
  }
}

static void andrews(const double *q, const double *v, double *a) {
  double A[ANDREWS_N][ANDREWS_N] = {{0.0}}, b[ANDREWS_N];
  double th = q[1], ga = q[2], ph = q[3], om = q[5];
  double bep = v[0], thp = v[1], gap = v[2], php = v[3], dep = v[4], omp = v[5], epp = v[6];
  double sbe = sin(q[0]), cbe = cos(q[0]), sth = sin(th), cth = cos(th), sga = sin(ga);
  double cga = cos(ga), sph = sin(ph), cph = cos(ph), sde = sin(q[4]), cde = cos(q[4]);
  double som = sin(om), com = cos(om), sep = sin(q[6]), cep = cos(q[6]);
  double sbt = sin(q[0] + th), cbt = cos(q[0] + th), spd = sin(ph + q[4]), cpd = cos(ph + q[4]);
  double soe = sin(om + q[6]), coe = cos(om + q[6]), E = e - ea, F = zf - fa;
  A[0][0] = m1 * ra * ra + m2 * (rr * rr - 2.0 * da * rr * cth + da * da) + i1 + i2;
  A[0][1] = A[1][0] = m2 * (da * da - da * rr * cth) + i2;
  A[1][1] = m2 * da * da + i2;
  A[2][2] = m3 * (sa * sa + sb * sb) + i3;
  A[3][3] = m4 * E * E + i4;
  A[3][4] = A[4][3] = m4 * (E * E + zt * E * sph) + i4;
  A[4][4] = m4 * (zt * zt + 2.0 * zt * E * sph + E * E) + m5 * (ta * ta + tb * tb) + i4 + i5;
  A[5][5] = m6 * F * F + i6;
  A[5][6] = A[6][5] = m6 * (F * F - lu * F * som) + i6;
  A[6][6] = m6 * (F * F - 2.0 * lu * F * som + lu * lu) + m7 * (ua * ua + ub * ub) + i6 + i7;
  double xd = sd * cga + sc * sga + xb, yd = sd * sga - sc * cga + yb;
  double length = sqrt((xd - xc) * (xd - xc) + (yd - yc) * (yd - yc));
  double force = -c0 * (length - l0) / length, fx = force * (xd - xc), fy = force * (yd - yc);
  b[0] = mom - m2 * da * rr * thp * (thp + 2.0 * bep) * sth;
  b[1] = m2 * da * rr * bep * bep * sth;
  b[2] = fx * (sc * cga - sd * sga) + fy * (sd * cga + sc * sga);
  b[3] = m4 * zt * E * dep * dep * cph;
  b[4] = -m4 * zt * E * php * (php + 2.0 * dep) * cph;
  b[5] = -m6 * lu * F * epp * epp * com;
  b[6] = m6 * lu * F * omp * (omp + 2.0 * epp) * com;
  for (int i = 0; i < 3; i++) {
    double *x = A[7 + 2 * i], *y = A[8 + 2 * i];
    x[0] = -rr * sbe + d * sbt, x[1] = d * sbt, y[0] = rr * cbe - d * cbt, y[1] = -d * cbt;
  }
  A[7][2] = -ss * cga, A[8][2] = -ss * sga;
  A[9][3] = -e * cpd, A[9][4] = -e * cpd + zt * sde;
  A[10][3] = -e * spd, A[10][4] = -e * spd - zt * cde;
  A[11][5] = zf * soe, A[11][6] = zf * soe - lu * cep;
  A[12][5] = -zf * coe, A[12][6] = -zf * coe - lu * sep;
  for (int i = 7; i < ANDREWS_N; i++)
    for (int j = 0; j < 7; j++) A[j][i] = A[i][j];
  double bt = (bep + thp) * (bep + thp), pd = (php + dep) * (php + dep);
  double oe = (omp + epp) * (omp + epp), g2 = gap * gap, de2 = dep * dep, ep2 = epp * epp;
  double x = rr * cbe * bep * bep - d * cbt * bt, y = rr * sbe * bep * bep - d * sbt * bt;
  b[7] = x - ss * sga * g2, b[8] = y + ss * cga * g2;
  b[9] = x - e * spd * pd - zt * cde * de2, b[10] = y + e * cpd * pd - zt * sde * de2;
  b[11] = x - zf * coe * oe - lu * sep * ep2, b[12] = y - zf * soe * oe + lu * cep * ep2;
  solve_dense(A, b);
  memcpy(a, b, 7 * sizeof *a);
}
