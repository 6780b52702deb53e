"""Many contacts with friction beside rows between bounds: the laws, least norm, hard cases."""

import numpy as np
import pytest

from mbd_ros.core.complementarity.contact_problem import ContactProblem
from mbd_ros.core.rows.constraint_rows import Cone
from mbd_ros.errors import SolveError

CORNERS = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
DOWN = np.array([0.0, 0.0, -9.81e-3, 0.0, 0.0, 0.0])


def point_rows(r, axes):
    """Velocity of a point r of a body along axes, from that of its mass centre."""
    x, y, z = r
    return axes @ np.hstack((np.eye(3), [[0, z, -y], [-z, 0, x], [y, -x, 0]]))


def frame(normal):
    """A normal and two tangents, one a row."""
    n = normal / np.linalg.norm(normal)
    t = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    t /= np.linalg.norm(t)
    return np.array((n, t, np.cross(n, t)))


UP = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])


class World:
    """Free bodies, their contacts and velocities: everything a problem is made of."""

    def __init__(self, masses, sizes=1.0):
        masses = np.asarray(masses, dtype=float)
        inertia = masses * np.broadcast_to(sizes, len(masses)) ** 2 / 6.0
        self.M = np.column_stack((masses,) * 3 + (inertia,) * 3).ravel()
        self.J, self.mu = [], []

    def touch(self, a, r_a, b=None, r_b=None, axes=UP, mu=0.5):
        row = np.zeros((3, len(self.M)))
        row[:, 6 * a : 6 * a + 6] = point_rows(r_a, axes)
        if b is not None:
            row[:, 6 * b : 6 * b + 6] -= point_rows(r_b, axes)
        self.J.append(row)
        self.mu.append(mu)

    def problem(self, v):
        J = np.concatenate(self.J)
        return (J / self.M) @ J.T, J @ v, np.array(self.mu), float(v @ (self.M * v)) ** 0.5


def box_world(rng):
    size = 10 ** rng.uniform(-2, 1)
    world = World([10 ** rng.uniform(-3, 3)], size)
    for x, y in CORNERS:
        world.touch(0, np.array((x, y, -1)) * size / 2, mu=rng.choice([0.0, 0.1, 0.5, 1.0, 3.0]))
    v = DOWN + rng.choice([0.0, 1e-3, 1.0]) * rng.normal(size=6)
    return world.problem(v)


def pile_world(rng):
    n = int(rng.integers(1, 6))
    sizes = 10 ** rng.uniform(-0.5, 0.5, n)
    world = World(10 ** rng.uniform(-3, 3, n), sizes)
    for _ in range(int(rng.integers(1, 9))):
        a, b = (int(i) for i in rng.integers(0, n, 2))
        r_a, r_b = (rng.normal(size=3) * sizes[i] for i in (a, b))
        other = (None, None) if a == b else (b, r_b)
        world.touch(a, r_a, *other, frame(rng.normal(size=3)), rng.choice([0, 0.3, 0.8, 2.0]))
    return world.problem(rng.normal(size=6 * n))


def stack_world(rng):
    n = int(rng.integers(2, 5))
    world = World(10 ** rng.uniform(0, 6, n))
    for i in range(n):
        for x, y in CORNERS:
            r = np.array((x, y, -1)) / 2
            world.touch(i, r, i - 1 if i else None, r + UP[0], mu=0.5)
    return world.problem(np.tile(DOWN, n) + 1e-3 * rng.integers(0, 2) * rng.normal(size=6 * n))


def solver(A, mu):
    cones = [Cone(f"c{i}", slice(3 * i, 3 * i + 3), float(f), 0.0) for i, f in enumerate(mu)]
    return ContactProblem(A, A.diagonal().copy(), [f"row_{i}" for i in range(len(A))], cones)


def check_laws(A, b, mu, p, speed, rounding=1e-9):
    """Signorini and Coulomb, condition by condition and contact by contact."""
    w = A @ p + b
    for i, f in enumerate(mu):
        at = slice(3 * i, 3 * i + 3)
        fast, push = (
            speed * A.diagonal()[at].max() ** 0.5,
            speed / A[at, at][0, 0] ** 0.5 + p[at][0],
        )
        normal, friction, slip = p[at][0], np.hypot(*p[at][1:]), np.hypot(*w[at][1:])
        assert normal >= 0.0 and w[at][0] >= -rounding * fast
        assert min(normal / push, w[at][0] / fast) <= rounding
        assert friction <= f * normal * (1.0 + 1e-12)
        if slip > 1e-7 * fast and f * normal > 1e-7 * push:
            assert friction == pytest.approx(f * normal, rel=1e-9)
            assert p[at][1:] / friction == pytest.approx(-w[at][1:] / slip, abs=1e-5)


@pytest.mark.parametrize("world", [box_world, pile_world, stack_world])
def test_random_worlds_keep_the_laws(world):
    """Redundant feet, steep cones, mass ratios up to 1e6."""
    rng = np.random.default_rng(4)
    for _ in range(60):
        A, b, mu, speed = world(rng)
        problem = solver(A, mu)
        p = problem.pushing(b, speed)
        check_laws(A, b, mu, p, speed)
        rounding = 1e-13 * (np.abs(A) @ np.abs(p) + np.abs(b)).max()
        assert max(problem.residuals[::3]) <= rounding
        assert problem.residuals.dual == 0.0
        again = problem.solve(b, 0 * b, 0 * b + np.inf, speed, warm=p)
        check_laws(A, b, mu, again, speed)


def test_residuals_are_those_of_wrong_impulses():
    """Each law broken by hand; the sizes are those of the closed form of one box at rest."""
    A, b, mu, speed = box_world(np.random.default_rng(0))
    problem = solver(A, mu)
    problem.pushing(b, speed)
    p, *others = problem._answered
    p[0] = -2.0
    problem._answered = (p, *others)
    assert problem.residuals.dual == 2.0 and problem.residuals.primal > 0.0


def test_a_stack_of_mass_ratio_a_million_is_exact():
    """C06: the sums over interfaces are the weights above them."""
    world = World([1.0, 1.0, 1.0e6])
    for i in range(3):
        for x, y in CORNERS:
            r = np.array((x, y, -1)) / 2
            world.touch(i, r, i - 1 if i else None, r + UP[0])
    A, b, mu, speed = world.problem(np.tile(DOWN, 3))
    p = solver(A, mu).pushing(b, speed) / 1e-3
    forces = p[::3].reshape(3, 4).sum(axis=1)
    assert forces == pytest.approx([9810019.62, 9810009.81, 9810000.0], rel=1e-9)


def table(x, y, load):
    """A table of 4 kg with a load of some kilograms at x, y, in units of half its length."""
    mass = 4.0 + load
    world = World([mass])
    centre = load / mass * np.array((x, y, 0.0))
    for corner in CORNERS:
        world.touch(0, np.array((*corner, -0.8)) - centre)
    A, b, mu, speed = world.problem(DOWN)
    p = solver(A, mu).pushing(b, speed) / 1e-3
    assert np.abs(p.reshape(4, 3)[:, 1:]).max() <= 1e-10
    return p[::3]


def test_feet_of_a_table_share_with_the_least_norm():
    """C06: the split of four equal springs."""
    assert table(0.5, -0.25, 1.0) == pytest.approx([12.875625, 10.423125, 11.649375, 14.101875])


def test_a_foot_that_would_pull_carries_nothing():
    """40 kg over one foot: N + c (1, -1, 1, -1) with c from N_3 = 0."""
    assert table(1.0, 1.0, 40.0) == pytest.approx([392.4, 19.62, 0.0, 19.62], abs=1e-9)


def test_rows_between_bounds_beside_contacts():
    """A block on a plane, and a brake of given force along x beside its friction."""
    world = World([2.0])
    world.touch(0, np.zeros(3), mu=0.25)
    A, b, _, speed = world.problem(np.array([0.3, 0.0, -0.2, 0.0, 0.0, 0.0]))
    A = np.block([[A, A[:, 1:2]], [A[1:2], A[1:2, 1:2]]])
    b = np.append(b, b[1])
    problem = solver(A, [0.25])
    for brake in (0.05, 0.4, 10.0):
        p = problem.solve(b, np.array([0, 0, 0, -brake]), np.array([0, 0, 0, brake]), speed)
        left = 2.0 * 0.3 - 0.25 * 0.4
        assert p[0] == pytest.approx(0.4, rel=1e-13)
        if brake < left:
            assert p[[1, 3]] == pytest.approx([-0.1, -brake], rel=1e-12)
        else:
            assert p[1] + p[3] == pytest.approx(-0.6, rel=1e-12) and abs(p[1]) <= 0.1 + 1e-12


def beside_contacts(rng):
    """Contacts of random rows with rows after them: one-sided ones, brakes, some repeated."""
    bodies, count, others = (int(rng.integers(*ends)) for ends in ((3, 9), (1, 4), (1, 5)))
    J = rng.normal(size=(3 * count + others, bodies))
    J[-1] = J[0] if rng.random() < 0.3 else J[-1]
    M, v = 10 ** rng.uniform(-2, 2, bodies), rng.normal(size=bodies)
    A, lower, upper = (J / M) @ J.T, np.zeros(len(J)), np.full(len(J), np.inf)
    brakes = 3 * count + np.flatnonzero(rng.random(others) < 0.5)
    upper[brakes] = 0.3 * np.sqrt(v @ (M * v) / A.diagonal()[brakes])
    lower[brakes] = -upper[brakes]
    return A, J @ v, rng.choice([0.0, 0.3, 0.8], count), float(v @ (M * v)) ** 0.5, lower, upper


def test_random_rows_between_bounds_keep_their_laws_too():
    rng = np.random.default_rng(6)
    for _ in range(60):
        A, b, mu, speed, lower, upper = beside_contacts(rng)
        p = solver(A, mu).solve(b, lower, upper, speed)
        n, w = 3 * len(mu), A @ p + b
        check_laws(A[:n, :n], b[:n] + A[:n, n:] @ p[n:], mu, p[:n], speed)
        for i in range(n, len(b)):
            slack = 1e-9 * speed * A[i, i] ** 0.5
            assert lower[i] * (1 + 1e-14) <= p[i] <= upper[i] * (1 + 1e-14)
            assert w[i] <= slack or p[i] == pytest.approx(lower[i], rel=1e-14)
            assert w[i] >= -slack or p[i] == pytest.approx(upper[i], rel=1e-14)


def test_friction_may_be_against_the_slip_of_another_time():
    """A ball that turns round within a step: friction is against the sum of both slips."""
    world = World([1.0])
    world.touch(0, np.zeros(3), mu=0.1)
    A, b, mu, speed = world.problem(np.array([0.1, 0.0, -1.0, 0, 0, 0]))
    p = solver(A, mu).solve(b, 0 * b, 0 * b + np.inf, speed, late=np.array([0.0, -0.3, 0.4]))
    slip = np.array((0.1 - 0.3, 0.4)) + p[1:]
    assert p[1:] == pytest.approx(-0.1 * slip / np.linalg.norm(slip), abs=1e-14)


def test_contacts_that_contradict_one_another_are_refused_by_name():
    """A point between two walls that come nearer."""
    world = World([1.0])
    world.touch(0, np.zeros(3))
    world.touch(0, np.zeros(3), axes=-UP)
    A, b, mu, speed = world.problem(np.ones(6))
    b[[0, 3]] = -1.0
    with pytest.raises(SolveError, match=r"no impulses are found for contacts .* row row_"):
        solver(A, mu).pushing(b, speed)
