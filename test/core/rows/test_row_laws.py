"""Laws of multipliers, levels and slots of rows; what no solver serves is refused by name."""

import ast
import math

import mechanisms
import numpy as np
import pytest
from places import ROOT

from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.rows.constraint import (
    Constraint,
    Kind,
    Level,
    Row,
    bilateral,
    box,
    cone,
    drive,
    unilateral,
)
from mbd_ros.core.rows.constraint_rows import ConstraintRows, RowLayout, rigid
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.parts.constraints.dry_friction import DryFriction
from mbd_ros.parts.constraints.joint_stop import JointStop
from mbd_ros.parts.constraints.prescribed_motion import PrescribedMotion

CHAIN = read_robot(mechanisms.chain(3))


class Held(Constraint):
    """The first joints at 0, one row each, under any law."""

    def __init__(self, law, level=Level.POSITION, gains=(0.0, 0.0), m=1, smoothed=False):
        self.law, self.level, self.gains, self.smoothed = law, level, gains, smoothed
        self.rows = tuple(Row(f"held_{i}", "N·m") for i in range(m))

    def residual(self, k, x):
        assert self.level is Level.POSITION, "rows of velocities have no g"
        return x.q[: len(self.rows)]

    def jacobian(self, k, x):
        return np.eye(3)[: len(self.rows)]

    def drift(self, k, x):
        return np.zeros(len(self.rows))


class Latch(Held):
    """A row that is on in mode (1,)."""

    def acts(self, mode):
        return mode == (1,)


class Sliding(Held):
    """Its rows hold joints and push along other ones."""

    slips = True

    def pushes(self, k, x):
        return np.eye(3)[1 : 1 + len(self.rows)]


def built(*parts):
    return build_system(CHAIN, Couplings(CHAIN, ()), parts, Loads(3))


def test_only_bilateral_rows_and_drives_without_a_limit_are_rigid():
    assert bilateral().is_rigid and drive().is_rigid
    for law in (drive(2.0), box(-1.0, 1.0), unilateral(), cone(0.5)):
        assert not law.is_rigid
    assert [law.kind for law in (drive(), unilateral(0.3))] == [Kind.DRIVE, Kind.UNILATERAL]


def test_slots_are_the_same_in_every_mode_and_cover_all_rows():
    parts = [
        Held(bilateral(), m=2),
        JointStop(CHAIN, joints=["joint_1", "joint_2"], upper=1.0, lower=-1.0),
        Latch(bilateral()),
        DryFriction(CHAIN, joint="joint_3", limit=1.0),
        PrescribedMotion(CHAIN, joint="joint_1", polynomial=[0.0], limit=2.0),
    ]
    layout = RowLayout(parts)
    assert [block.slots for block in layout.blocks] == [
        slice(0, 2),
        slice(2, 4),
        slice(4, 5),
        slice(5, 6),
        slice(6, 7),
    ]
    assert layout.on((1,)) == layout.blocks
    assert layout.on(()) == (*layout.blocks[:2], *layout.blocks[3:])
    assert [b.part for b in layout.of(Level.VELOCITY)] == [parts[3]]
    assert [b.part for b in layout.rigid] == rigid(parts) == [parts[0], parts[2]]
    assert [b.part for b in layout.having(Kind.DRIVE, Kind.UNILATERAL)] == [parts[1], parts[4]]
    rows = ConstraintRows(layout.yielding, 3)
    assert rows.slots.tolist() == [2, 3, 5, 6]
    assert [row.name for row in layout.rows][:2] == ["held.held_0", "held.held_1"]
    assert layout.rows[4].name == "latch.held_0" and layout.blocks[2].rows == layout.rows[4:5]


def test_every_three_rows_of_a_cone_are_a_contact():
    parts = [Held(bilateral(), m=2), Held(cone([0.5, 0.7], 0.3), m=6), Held(cone(0.2), m=6)]
    layout = RowLayout(parts)
    assert layout.cones == (
        ("held.held_0#2", slice(2, 5), 0.5, 0.3),
        ("held.held_3", slice(5, 8), 0.7, 0.3),
        ("held.held_0#3", slice(8, 11), 0.2, 0.0),
        ("held.held_3#2", slice(11, 14), 0.2, 0.0),
    )
    rows = ConstraintRows(layout.yielding, 3)
    assert [cone.slots.start for cone in rows.cones] == [0, 3, 6, 9]
    assert rows.upper.tolist() == 4 * [np.inf, 0.0, 0.0] and not rows.lower.any()
    assert rows.is_rate.tolist() == 4 * [False, True, True]


def test_gains_are_one_number_or_one_a_row():
    block = RowLayout([Held(box(-1.0, [1.0, 2.0]), gains=(4.0, np.array((1.0, 3.0))), m=2)]).blocks
    kp, kd = block[0].gains
    assert kp.tolist() == [4.0, 4.0] and kd.tolist() == [1.0, 3.0]
    rows, x = ConstraintRows(block, 3), State(0.0, np.array((0.1, 0.2, 0.3)), np.ones(3))
    assert rows.lower.tolist() == [-1.0, -1.0] and rows.upper.tolist() == [1.0, 2.0]
    assert rows.conditions(None, x)[1] == pytest.approx([1.0 + 0.4, 3.0 + 0.8])


@pytest.mark.parametrize("count", [1, 2])
def test_rows_of_velocities_are_never_asked_for_g(count):
    parts = [Held(box(-1.0, 1.0), Level.VELOCITY, gains=(0.0, 5.0)) for _ in range(count)]
    rows, x = ConstraintRows(RowLayout(parts).blocks, 3), State(0.0, np.ones(3), np.ones(3))
    assert rows.residual(None, x).tolist() == [0.0] * count
    assert rows.conditions(None, x)[1].tolist() == [5.0] * count


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (
            Held(cone(0.5), m=3, smoothed=True),
            "row held.held_0 has the law cone and is smoothed, which no solver serves",
        ),
        (
            Held(unilateral(0.3), smoothed=True),
            "row held.held_0 has restitution 0.3 and is smoothed, which no solver serves",
        ),
        (Latch(bilateral()), "row latch.held_0 comes and goes with the mode, which no solver"),
        (
            Sliding(bilateral()),
            "row sliding.held_0 pushes along another direction than it holds, which",
        ),
        (
            Held(unilateral(), Level.VELOCITY, smoothed=True),
            "held_0 has the law unilateral on velocities and is smoothed, which",
        ),
    ],
)
def test_laws_that_no_solver_serves_are_refused_by_name(part, message):
    with pytest.raises(ModelError, match=message):
        built(part)


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (Held(cone(0.5)), "a cone has 3 rows a contact, a normal and two tangents; this has 1"),
        (Held(cone(0.5), m=4), "a cone has 3 rows a contact, a normal and two tangents; this has"),
        (Held(cone(-0.5), m=3), "friction -0.5 must be >= 0 and finite"),
        (Held(cone([0.5, math.nan]), m=6), "friction nan must be >= 0 and finite"),
        (Held(cone([0.5, 0.6]), m=9), "friction is one number or 3, one a contact"),
        (Held(unilateral(1.5)), "restitution 1.5 must be within 0 .. 1"),
        (Held(box(2.0, 1.0)), "the lower bound of a multiplier is above the upper one"),
        (Held(box(math.nan, 1.0)), "the lower bound of a multiplier is above the upper one"),
        (Held(box(0.0, [1.0, 2.0, 3.0]), m=2), "bounds and gains are one number or 2, one a row"),
    ],
)
def test_laws_that_do_not_fit_their_rows_name_them(part, message):
    with pytest.raises(ModelError, match=f"constraint Held with row held.held_0.*{message}"):
        RowLayout([part])


def test_bounds_that_depend_on_the_state_are_those_of_that_state():
    """Friction that grows with the angle, as that of a joint under load, against constant ones."""
    limits = {0.1: 1.1, 2.0: 3.0}
    law = box(lambda k, x: [-1.0 - x.q[0]], lambda k, x: 1.0 + x.q[0])
    assert law.varies and not law.is_rigid and not box(-1.0, 1.0).varies
    varying = built(Held(law, Level.VELOCITY, gains=(0.0, 100.0)))
    for angle, limit in [*limits.items(), *reversed(limits.items())]:
        constant = built(Held(box(-limit, limit), Level.VELOCITY, gains=(0.0, 100.0)))
        for speed in (9.0, 1e-4, -9.0):
            x = State(0.0, np.array((angle, 0.0, 0.0)), np.array((speed, 0.0, 0.0)))
            found, expected = varying.evaluate(x), constant.evaluate(x)
            assert np.array_equal(found.a, expected.a)
            assert found.lam == pytest.approx(expected.lam, rel=1e-15)
            assert abs(speed) < 1.0 or abs(found.lam[0]) == limit
    crossed = built(Held(box(lambda k, x: x.q[0], 1.0)))
    with pytest.raises(SolveError, match="bound of row held.held_0 is above its upper bound"):
        crossed.evaluate(State(0.0, np.full(3, 2.0), np.ones(3)))


def test_multipliers_push_along_the_rows_or_beside_them():
    parts = [Held(bilateral(), m=2), Sliding(box(-1.0, 1.0))]
    rows, x = ConstraintRows(RowLayout(parts).blocks, 3), State(0.0, np.ones(3), np.ones(3))
    assert rows.jacobian(None, x).tolist() == np.eye(3)[[0, 1, 0]].tolist()
    assert rows.pushes(None, x).tolist() == np.eye(3)[[0, 1, 1]].tolist()


ASKING = ("getattr", "hasattr")
OTHERS = (  # what unknowns of a program are limited to, and where a file begins and ends
    "mbd_ros/optimal_control",
    "mbd_ros/features/prediction",
    "mbd_ros/features/loads",
)
# Bounds of states in a moving horizon; of tasks, whether `mbd-ros inverse` has --bounds.
OPTIONS = {"batch", "task", "node", "process"}


def doors(source):
    """Lines that read what multipliers are limited to."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute):
            owner = getattr(node.value, "attr", getattr(node.value, "id", ""))
            is_of_law = owner == "law" and node.attr in ("lower", "upper")
            if is_of_law or (node.attr == "bounds" and owner not in OPTIONS):
                yield node.lineno
        is_call = isinstance(node, ast.Call) and getattr(node.func, "id", "") in ASKING
        if is_call and getattr(node.args[1], "value", "") == "bounds":
            yield node.lineno


def test_nobody_outside_the_rows_asks_for_bounds():
    own = [ROOT / "mbd_ros/core/rows", *(ROOT / other for other in OTHERS)]
    found = [
        f"{path.relative_to(ROOT)}:{line}"
        for path in sorted((ROOT / "mbd_ros").rglob("*.py"))
        if not any(path.is_relative_to(one) for one in own)
        for line in doors(path.read_text(encoding="utf-8"))
    ]
    assert found == []
    asked = "part.bounds\ngetattr(part, 'bounds')\nlaw.lower\nlaw.kind\nrows.lower"
    assert sorted(doors(asked)) == [1, 2, 3]
