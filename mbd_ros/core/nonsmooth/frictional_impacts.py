"""Impulses of impacts with friction: the compression, then the expansion that Poisson asks for.

    compression   p_n >= 0,      w_n >= 0,   p_n w_n = 0,               Coulomb's law with w_c
    expansion     p_n >= s e c,  w_n >= 0,   (p_n - s e c) w_n = 0,     Coulomb's law with w+

c are the normal impulses of the compression, w rates of the rows after it and after both, e the
restitution. The share s is 1, or less where the whole would gain energy; `impact_map` says why.
"""

from collections.abc import Sequence

from mbd_ros.core.complementarity.contact_problem import ContactProblem
from mbd_ros.core.dynamics.mechanism import ImpulseResponse
from mbd_ros.core.rows.constraint_rows import Cone
from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError

_GAINS = 1.0e-13  # of the energy before: work of impulses that is none
_HALVINGS = 20


def with_friction(
    response: ImpulseResponse,
    names: Sequence[str],
    cones: Sequence[Cone],
    e: Array,
    approach: Array,
    speed: float,
) -> tuple[Array, float]:
    """Impulses of the rows that touch, and the share of their restitution that is given back.

    The whole is given back unless it gains energy or nothing answers it.

    Args:
        response: To impulses of these rows.
        names: Of the rows.
        cones: The contacts among them.
        e: Restitution of the rows, 0 at tangents, shape (m,).
        approach: Their rates before the impact, shape (m,).
        speed: Velocity before it, in the mass metric.

    Raises:
        SolveError: Nothing can keep a row from closing further, or no impulses are found.
    """
    problem = ContactProblem(response.A, response.loose, names, cones)
    compression = problem.pushing(approach, speed)
    restored = e * compression
    if not restored.any():
        return compression, 1.0
    after = approach + response.A.dot(compression)

    def impulses(share: float) -> Array | None:
        """None where there are none, or those that gain energy."""
        try:
            p = compression + problem.pushing(after, speed, share * restored)
        except SolveError:
            return None
        work = float(p.dot(approach + 0.5 * response.A.dot(p)))
        return p if work <= _GAINS * speed * speed else None

    best, low, high = compression, 0.0, 1.0
    if (whole := impulses(1.0)) is not None:
        return whole, 1.0
    for _ in range(_HALVINGS):
        share = 0.5 * (low + high)
        p = impulses(share)
        if p is None:
            high = share
        else:
            low, best = share, p
    return best, low
