"""A contact with friction: the exact solution of one cone, and its impact."""

import mechanisms
import numpy as np
import pytest
from cone_contact import FRICTIONS, touch_down
from mechanisms import joint, link, urdf
from scipy.optimize import root
from velocity_level import system_of

from mbd_ros.core.complementarity.contact_cone import cone_contact
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.nonsmooth.impact_map import ImpactMap
from mbd_ros.core.state import State
from mbd_ros.errors import SolveError


def broken_laws(A, b, mu, p, least=0.0, rounding=1e-9):
    """Conditions of Signorini and Coulomb that fail; sizes are those of b and of what ends it."""
    w, rate, push = A @ p + b, np.abs(b).max(), np.abs(b).max() / A[0, 0] + least
    normal, friction, slip = p[0], np.linalg.norm(p[1:]), np.linalg.norm(w[1:])
    kept = {
        "least normal": normal >= least - rounding * push,
        "no approach": w[0] >= -rounding * rate,
        "complementary": min((normal - least) / push, w[0] / rate) <= rounding,
        "cone": friction <= mu * normal + rounding * push,
    }
    if slip > rounding * rate:
        kept["largest friction"] = friction == pytest.approx(mu * normal, abs=rounding * push)
        against = pytest.approx(-friction * w[1:] / slip, abs=1e-6 * push)
        kept["against the slip"] = p[1:] == against
    return [law for law, is_kept in kept.items() if not is_kept]


@pytest.mark.parametrize("mu", FRICTIONS)
@pytest.mark.parametrize("bodies", [2, 3, 6])
def test_random_contacts_keep_the_laws(mu, bodies):
    """Also where two coordinates alone move the point, so that A is singular."""
    rng = np.random.default_rng(bodies)
    for i in range(150):
        B = rng.normal(size=(3, bodies))
        A, b = B @ B.T, B @ rng.normal(size=bodies)
        least = 0.0 if i % 2 else float(rng.uniform(0.0, 2.0) / A[0, 0])
        assert not broken_laws(A, b, mu, cone_contact(A, b, mu, least), least)


@pytest.mark.parametrize("mu", FRICTIONS)
@pytest.mark.parametrize("bodies", [1, 2])
def test_what_nothing_moves_slips_on(mu, bodies):
    """A belt runs under a point, along a direction in which nothing can follow it.

    Friction is too weak to jam the point, which has no answer.
    """
    rng = np.random.default_rng(bodies)
    for i in range(100):
        B = rng.normal(size=(3, bodies))
        B[0] = rng.uniform(0.5, 1.0, bodies)
        B[1:] *= 0.5 / (max(mu, 0.1) * np.abs(B[1:]).sum())
        b = B @ rng.normal(size=bodies)
        b[1:] += 10.0 ** rng.uniform(-8.0, 0.0) * rng.normal(size=2)
        least = 0.0 if i % 2 else float(rng.uniform(0.0, 2.0))
        A = B @ B.T
        assert not broken_laws(A, b, mu, cone_contact(A, b, mu, least), least, 1e-10)


def test_answers_are_those_of_a_root_search():
    """De Saxcé's equation by scipy, from many starts; among coupling that has one answer."""
    rng, slips = np.random.default_rng(1), 0
    for _ in range(60):
        B = rng.normal(size=(3, 8))
        A, b, mu = B @ B.T, rng.normal(size=3), float(rng.uniform(0.1, 0.6))
        found = cone_contact(A, b, mu)
        size = np.abs(b).max() / A[0, 0]

        def natural_map(p, A=A, b=b, mu=mu):
            w = A @ p + b
            normal = max(p[0] - w[0] / A[0, 0], 0.0)
            pushed, most = p[1:] - w[1:] / A.diagonal().max(), mu * max(p[0], 0.0)
            length = np.linalg.norm(pushed)
            return p - np.array((normal, *(pushed * min(1.0, most / max(length, 1e-300)))))

        tries = [root(natural_map, size * rng.normal(size=3), tol=1e-14) for _ in range(12)]
        ends = [one.x for one in tries if np.abs(natural_map(one.x)).max() <= 1e-11 * size]
        assert ends and min(np.abs(found - end).max() for end in ends) <= 1e-8 * size
        slips += bool(found[0] > 0.0 and np.linalg.norm(A[1:] @ found + b[1:]) > 1e-9)
    assert slips >= 10


def test_units_of_mass_and_time_change_nothing():
    rng = np.random.default_rng(2)
    for _ in range(50):
        B = rng.normal(size=(3, 5))
        A, b, mu = B @ B.T, rng.normal(size=3), float(rng.uniform(0.0, 2.0))
        once = cone_contact(A, b, mu)
        for mass, speed in ((1e-12, 1.0), (1e12, 1e-3), (1.0, 1e6)):
            again = cone_contact(A / mass, speed * b, mu) / (mass * speed)
            assert again == pytest.approx(once, abs=1e-9 * max(np.abs(once).max(), 1e-9))


POINT = read_robot(
    urdf(
        *(link("world"), link("a"), link("b"), link("bob", 2.5)),
        joint("x", "prismatic", "world", "a", (1, 0, 0)),
        joint("y", "prismatic", "a", "b", (0, 1, 0)),
        joint("z", "prismatic", "b", "bob", (0, 0, 1)),
    )
)


@pytest.mark.parametrize("e", [0.0, 0.4, 1.0])
@pytest.mark.parametrize("mu", [0.0, 0.2, 0.9])
@pytest.mark.parametrize("slide", [(0.5, -0.3), (0.0, 0.0), (3.0, 4.0)])
def test_a_point_mass_bounces_as_by_hand(e, mu, slide):
    """Normal -e v_n; friction takes mu (1 + e) v_n off the slip, or all of it."""
    part = touch_down(POINT, "bob", (0, 0, 2.0), friction=mu, restitution=e)
    v = np.array((*slide, -1.5))
    found = ImpactMap(system_of(POINT, [part])).impact(State(0.0, np.zeros(3), v), [0])
    speed = np.hypot(*slide)
    left = max(1.0 - mu * (1.0 + e) * 1.5 / speed, 0.0) if speed else 0.0
    assert found.v == pytest.approx([*(left * v[:2]), 1.5 * e], abs=1e-14)
    tangents = 2.5 * (found.v - v)[:2]
    assert found.p[0] == pytest.approx(2.5 * 1.5 * (1.0 + e), abs=1e-13)
    assert np.linalg.norm(found.p[1:]) == pytest.approx(np.linalg.norm(tangents), abs=1e-13)


def test_a_point_that_nothing_moves_is_no_contact():
    """A pendulum whose tip can not move along the normal: approach by rate alone is refused."""
    robot = read_robot(mechanisms.chain(1))
    part = touch_down(robot, "rod_1", (0, 0, 1), friction=0.3)
    level = ImpactMap(system_of(robot, [part]))
    x = State(0.0, np.zeros(1), np.ones(1))
    assert level.impact(x, [0]).v == pytest.approx([1.0])
    part.rate = lambda k, x: np.array((-1.0, 0.0, 0.0))
    with pytest.raises(SolveError, match=r"nothing can keep .*normal from closing"):
        level.impact(x, [0])
