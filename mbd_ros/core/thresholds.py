"""Thresholds for zero, for dependent rows and for toggles: one number for each question.

Every threshold names what it is relative to and why it has its size. The module stands before
all subjects of the core, since `rows` and `optimization` need it alike. Limits of iterations and
accuracies that belong to one method stay in the module of that method.
"""

TINY = 1.0e-300  # A divisor that was zero: what it divides neither overflows nor turns NaN.

# Condition numbers: the largest singular value of rows over the smallest. A = J M^-1 J' has the
# square of it, so that a solve with A loses twice as many digits.
TOGGLE = 1.0e6  # Rows in the mass metric. Four digits of the multipliers are left: unreliable.
NEAR_TOGGLE = 1.0e4  # The same. Eight are left: eigenvalues take over from Cholesky factors.
FOLD = 1.0e3  # Raw rows of the joints that nobody measures. They move so much more than the
# measured ones that these no longer tell two branches of a loop apart.
TOGGLE_RISE = 30.0  # Largest condition number of a run over its smallest: a toggle was passed.

# Ranks of products such as A, by eigenvalues or by the reciprocal condition, relative to the
# largest eigenvalue. A is scaled to a diagonal of at most one wherever units could differ.
NEARLY_SINGULAR = 1.0e-9  # Left out of a solve: at a toggle it would turn rounding into motion.
_REDUNDANT = 1.0e-13  # See `redundant`.
SINGULAR_MASS = 1.0e-16  # Times the size of a mass matrix with ones on its diagonal. It is smaller
# than `redundant`: a mass matrix is summed over bodies and is no product of a solve.
MASSLESS = 1.0e-30  # Of the largest moment of inertia: what rounding leaves of none, squared.

# Ranks of the rows themselves, by singular values. They see further than products do. With 1e-6,
# which is where `redundant` of a product ends, inverse dynamics loses the branch at a toggle.
SINGULAR = 1.0e-7  # Of the largest one, columns scaled; loops that are closed leave 1e-13.
FIXED_BY_OTHERS = 1.0e-9  # Of a row of length one: what rounding leaves where others fix it.

# Return maps of gaits.
FORGOTTEN = 1.0e-8  # Singular value of a derivative by differences over 1 or the largest one: what
# they leave of a direction in which resets forget everything.

# Rows and mobilities that vanish.
ROUNDED_ROW = 1.0e-13  # Entries of a row [m/rad or 1]: no mechanism has rows as small as that.
ZERO_ROW = 1.0e-20  # Of the largest A_ii: what rounding leaves of J = 0, squared.
SMALL_ROW = 1.0e-12  # A_ii [1/kg or 1/(kg m^2)] above which the two tests above are not made.
HELD_BY_ROWS = 1.0e-12  # Of a motion without rows: what is left of it where rows hold a joint.
CONTRADICTION = 1.0e-5  # Of the terms that should cancel in dependent rows. Directions that are
# shorter than 1e-6 count as dependent, and are off by as much.
NO_CONTRADICTION = 1.0e-12  # The same, in the mass metric, where all terms are zero.

# States on constraints and at limits, in rad or m of mechanisms of some metres.
LANDED = 1.0e-13  # |g|, or a step, where Newton's method ends: some rounding errors.
ON_MANIFOLD = 1.0e-12  # |g|, and |g'| per unit of velocity, accepted of consistent states.
ASSEMBLED = 1.0e-9  # |g| accepted where redundant rows or a toggle let it shrink no further.
NEAREST = 1.0e-11  # A step that no longer brings a state nearer to the measured one.
REACHED = 1.0e-9  # Distance from a limit that counts as reached.
CLOSED_GAP = 1.0e-12  # Of the largest gap to a limit: what may be left of it, or reach beyond.
BRANCH_STEP = 0.5  # Longest step of an iteration, so that it stays on the branch it is on.

# Events.
ON_SURFACE = 1.0e-12  # Of 1 + the largest position or velocity: a height over a surface, a gap or
# a slip velocity that is none.
TIE = 1.0e-10  # Of the terms of a rate: one that counts as zero where two modes begin.

SAME_TIME = 1.0e-9  # Of a step: two times that are meant to be the same, after sums of steps.


def redundant(n: int) -> float:
    """Return the rounding error of a zero eigenvalue of an n x n product, relative to the largest.

    Rounding grows with the sums in a product; small ones count as ten rows.
    """
    return _REDUNDANT * max(n, 10)
