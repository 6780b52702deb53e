"""Consistent states from inconsistent ones: nearest in the mass metric, or refused."""

import numpy as np
import pytest
from mechanisms import scene_of
from places import ROOT
from scipy.optimize import minimize

from mbd_ros.core.state import State
from mbd_ros.errors import SolveError
from mbd_ros.methods.projection.assembly import assemble, project, violation
from mbd_ros.scene.reader import load_scene

SCENES = ROOT / "config/scenes"
LOOPS = [
    "four_bar_leg",
    "benchmark/a02_four_bars_2",
    "benchmark/a03_andrews",
    "benchmark/a04_bricard",
]


def off(name, size, seed=0):
    """A system, and a state that is off its constraints by some `size`."""
    loaded, rng = load_scene(SCENES / f"{name}.yaml"), np.random.default_rng(seed)
    x, system = loaded.initial, loaded.system()
    q = x.q + size * rng.normal(size=len(x.q))
    return system, State(x.t, q, x.v + size * rng.normal(size=len(x.v)))


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("size", [1e-6, 1e-2, 0.1])
def test_assembled_state_is_consistent(name, size):
    system, x = off(name, size)
    y = assemble(system, x)
    left = violation(system, y)
    assert left.position <= 1e-12
    assert left.velocity <= 1e-12 * (1.0 + np.abs(y.v).max())
    assert np.abs(y.q - x.q).max() <= 20.0 * size


@pytest.mark.parametrize("name", ["four_bar_leg", "benchmark/a02_four_bars_2"])
def test_assembled_position_is_the_nearest_one(name):
    """Against SciPy's SLSQP on the same problem: min |q - q0|_M subject to g(q) = 0."""
    system, x = off(name, 0.05)
    M = system.mass(x.q).dense
    found = minimize(
        lambda q: 0.5 * (q - x.q) @ M @ (q - x.q),
        x.q,
        jac=lambda q: M @ (q - x.q),
        constraints={"type": "eq", "fun": lambda q: system.residual(x.t, q)},
        method="SLSQP",
        options={"ftol": 1e-15, "maxiter": 200},
    )
    y = assemble(system, x)
    away, other = y.q - x.q, found.x - x.q
    assert away @ M @ away <= other @ M @ other * (1.0 + 1e-6)
    assert np.abs(y.q - found.x).max() <= 1e-5  # SLSQP stops at some 1e-6


@pytest.mark.parametrize("name", LOOPS)
def test_velocity_is_the_nearest_one(name):
    """v - v0 is orthogonal, in the mass metric, to every motion that the constraints allow."""
    system, x = off(name, 0.1)
    y = assemble(system, x)
    J = system.jacobian(y.t, y.q)
    _, sizes, rows = np.linalg.svd(J)
    allowed = rows[np.count_nonzero(sizes > 1e-9 * sizes[0]) :]
    M = system.mass(y.q).dense
    assert np.abs(allowed @ M @ (y.v - x.v)).max() <= 1e-12 * np.abs(M).max() * 10


def test_branch_is_kept():
    """The crossed and the open four-bar both close the loop; the nearer one is taken."""
    loaded = load_scene(SCENES / "benchmark/x02_four_bar_1e-2.yaml")
    system, q = loaded.system(), loaded.initial.q
    for push in (-0.05, 0.05):
        y = assemble(system, State(0.0, q + push, np.zeros(3)))
        absolute = np.cumsum(y.q)
        assert abs(absolute[1]) <= 0.2  # the coupler stays level: the open branch
        assert abs(absolute[2] - absolute[0]) <= 0.2


def test_consistent_state_is_left_alone():
    system, x = off("four_bar_leg", 0.0)
    y = assemble(system, x)
    z = assemble(system, y)
    assert np.abs(z.q - y.q).max() <= 1e-12
    assert np.abs(z.v - y.v).max() <= 1e-12
    p = project(system, y)
    assert np.abs(p.q - y.q).max() <= 1e-12


def test_mechanism_that_cannot_close_is_refused_with_its_gap():
    scene = (SCENES / "benchmark/x02_four_bar_1e-2.yaml").read_text(encoding="utf-8")
    robots = (SCENES / "../robots").resolve()
    wide = scene.replace("../../robots", str(robots)).replace(
        "[0.99, 0.0, 0.0]", "[9.0, 0.0, 0.0]"
    )
    loaded = scene_of(wide)
    with pytest.raises(
        SolveError, match=r"cannot be assembled near this position: row .*is 8\.01 m"
    ):
        assemble(loaded.system(), loaded.initial)
