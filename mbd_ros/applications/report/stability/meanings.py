"""The meaning of cells, numbers and labels of the map, a sentence each."""

from mbd_ros.applications.report.stability.cases import (
    BOUNDED,
    CONVERGED,
    STOPPED,
    UNKNOWN,
    WARNED,
    WRONG,
)
from mbd_ros.applications.report.stability.steps import FITTING, LATEST
from mbd_ros.applications.report.stability.verdicts import ASKED, COARSE

_CELLS = (
    f"{CONVERGED}: within {ASKED:g} of the size of the motion, at every time after the start that "
    "can be compared.",
    f"{BOUNDED}: further off, but with bounded energy; shorter steps lead to the reference, or "
    "`check` or `simulate` warns of the step, or the step of an implicit method does not resolve "
    f"the motion (rate times step above {COARSE:g}); in the last two no shorter step is tried.",
    f"{STOPPED}: an error that names time, joint, link or row.",
    f"{WARNED}: garbage with finite numbers, of which `check` or `simulate` warns.",
    f"{UNKNOWN}: bounded energy and no warning, but no time after the start at which the motion "
    "is known, or all shorter steps fail and both they and the reference stop.",
    f"{WRONG}: not a number, another exception, finite but wrong without a warning, off while no "
    "shorter step leads to the reference, or a scene of this package that cannot be built or "
    "whose reference stops; any such cell fails the report.",
)
MEANINGS = (
    " ".join(_CELLS),
    "A number in the map is the power of ten of the largest error, rounded up and relative to the "
    "size of the motion: -4 is an error up to 1e-4, ~ -1 one up to 0.1 that is bounded. A cell "
    "without a number has an error of zero or none that can be told; an empty place is a method "
    "that does not take the scene.",
    f"Steps: the motion lasts at least {FITTING} steps, but no step makes it last longer than "
    f"{LATEST:g} s. What is run is the nearest step that meets the times of the comparison; a "
    "label of a step adds the multiples that were run where one is more than 20 % off. Where "
    "nothing has a rate no step is recommended. Methods that choose their steps are run once a "
    "scene: where several rows differ by the step, in that of the recommended one.",
    "References: DOP853 with tolerance 1e-9, which Gauss-Legendre of order 6 or DOPRI5 with "
    "tolerance confirms to 1e-4. Where a scene stands far away or passes gimbal lock, they "
    "come from other equations: the same scene at the origin in another tier, and Euler's "
    "equations in body axes. Cells named `equations` hold the accelerations against "
    "mechanics evaluated apart from the code that made them: Newton-Euler residual, g'' and J "
    "by differences of constraints evaluated from frame placements, complementarity, energy "
    "against the work done.",
)
