"""What stands between a control law and the drives: hand-over, guard, failures, memory."""

import numpy as np
import pytest
from mechanisms import chain, double_pendulum
from systems import free_system

from mbd_ros.core.model.coupling_functions import Linear, Polynomial
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.core.state import State
from mbd_ros.errors import SolveError
from mbd_ros.features.control.control_loop import ControlLoop, Guard
from mbd_ros.features.control.loop_watch import ChatterMeter
from mbd_ros.features.control.reference import ReferenceGenerator, ReferenceMap
from mbd_ros.features.control.trajectory import TargetError
from mbd_ros.methods.control.contract import Control, ControlledJoints, Controller, EffortBox
from mbd_ros.methods.simulation.safe_command import SafeCommand

NAMES = ["joint_1", "joint_2"]
DT = 1e-3
FREE = EffortBox(np.full(2, -np.inf), np.full(2, np.inf))


class Scripted(Controller):
    """A law that answers what it is told to; its memory counts seconds."""

    def __init__(self, joints, effort):
        self.joints, self.answer = joints, np.array(effort)

    def begin(self):
        return np.zeros(1)

    def effort(self, x, ref, memory, box):
        if self.answer is None:
            raise SolveError("no answer")
        s = self.joints.response(x).v - ref.v
        return Control(self.answer + memory, s, self.answer, np.ones(1), np.zeros(0, dtype=bool))


@pytest.fixture
def joints():
    robot = read_robot(double_pendulum())
    return ControlledJoints(free_system(robot), NAMES)


def loop_of(joints, effort=(8.0, -4.0), *, safe=None, ramp=0.1, **limits):
    limit = np.array(limits.pop("limit", [100.0, 100.0]))
    return ControlLoop(
        Scripted(joints, effort),
        ReferenceGenerator(joints),
        Guard(NAMES, limit, **limits),
        safe or SafeCommand("zero"),
        ramp,
        0.05,
        ChatterMeter(2),
    )


def states(begin=0.0, count=10_000, v=(0.0, 0.0)):
    return (State(begin + k * DT, np.array([0.3, 0.1]), np.array(v)) for k in range(count))


def run(loop, count, begin=0.0, v=(0.0, 0.0)):
    return np.array([loop.update(x).effort for x in states(begin, count, v)])


def test_control_takes_over_within_the_ramp_and_holds_where_it_began(joints):
    loop = loop_of(joints)
    loop.is_frozen = True
    efforts = run(loop, 151)
    expected = np.minimum(np.arange(151) * DT / 0.1, 1.0)[:, None] * [8.0, -4.0]
    np.testing.assert_allclose(efforts, expected, atol=1e-12)
    np.testing.assert_array_equal(loop.generator.at(1.0).q, [0.3, 0.1])


def test_the_share_of_the_safe_command_damps(joints):
    loop = loop_of(joints, (0.0, 0.0), safe=SafeCommand("damping", 2.0), ramp=1.0)
    loop.is_frozen = True
    first = loop.update(next(states(v=(1.0, -1.0)))).effort
    np.testing.assert_allclose(first, [-2.0, 2.0], atol=1e-12)


def test_silence_ramps_to_nothing_once_and_the_return_has_no_bump(joints):
    loop = loop_of(joints)
    loop.is_frozen = True
    run(loop, 200)
    falling = []
    while (effort := loop.lapse(0.01)) is not None:
        falling.append(effort)
    assert len(falling) == 10
    np.testing.assert_allclose(np.diff([[8.0, -4.0], *falling], axis=0), [[-0.8, 0.4]] * 10)
    np.testing.assert_array_equal(falling[-1], [0.0, 0.0])
    assert loop.lapse(0.01) is None
    back = run(loop, 200, begin=5.0)
    assert np.abs(np.diff([[0.0, 0.0], *back], axis=0)).max() <= 8.0 * DT / 0.1 + 1e-12
    np.testing.assert_allclose(back[-1], [8.0, -4.0])
    loop.lapse(0.01)
    half = loop.lapse(0.04)  # states come back before the command is safe
    again = run(loop, 2, begin=9.0)
    np.testing.assert_allclose(again[0], half, atol=1e-12)


def test_another_simulation_in_the_middle_of_a_lapse_begins_at_the_safe_command(joints):
    """Its first state may come before its clock says that time began anew."""
    loop = loop_of(joints)
    loop.is_frozen = True
    run(loop, 200)
    loop.lapse(0.01)
    np.testing.assert_allclose(loop.lapse(0.02), [5.6, -2.8])
    efforts = run(loop, 101)
    np.testing.assert_array_equal(efforts[0], [0.0, 0.0])
    assert np.abs(np.diff(efforts, axis=0)).max() <= 8.0 * DT / 0.1 + 1e-12
    np.testing.assert_allclose(efforts[-1], [8.0, -4.0])


def test_a_gap_right_after_the_first_state_is_no_part_of_the_ramp(joints):
    """The last state before a simulator froze may be the first that comes after it."""
    loop = loop_of(joints)
    loop.is_frozen = True
    efforts = [*run(loop, 1), *run(loop, 101, begin=0.7)]
    assert not np.any(efforts[:2])
    assert np.abs(np.diff(efforts, axis=0)).max() <= 8.0 * DT / 0.1 + 1e-12
    np.testing.assert_allclose(efforts[-1], [8.0, -4.0])


def test_size_and_rate_of_what_leaves_are_limited(joints):
    loop = loop_of(joints, (8.0, -400.0), ramp=0.0, limit=[5.0, 100.0], rate=1000.0)
    loop.is_frozen = True
    efforts = run(loop, 200)
    assert np.abs(np.diff(efforts, axis=0)).max() <= 1000.0 * DT * (1 + 1e-9)
    np.testing.assert_array_equal(efforts[-1], [5.0, -100.0])
    late = State(9.0, np.array([0.3, 0.1]), np.zeros(2))
    loop.controller.answer = np.array([-500.0, 500.0])
    np.testing.assert_allclose(loop.update(late).effort, [-5.0, -50.0])  # 0.05 s at most count
    assert Guard(NAMES, np.array([0.0, 1.0])).powerless == ("joint_1",)
    with pytest.raises(SolveError, match="joint_2 is not finite"):
        Guard(NAMES, np.ones(2)).admit(np.array([0.0, np.nan]), FREE)


@pytest.mark.parametrize("answer", [None, [np.nan, 0.0], [np.inf, 0.0]])
def test_a_law_without_an_answer_keeps_its_last_one_and_is_counted(joints, answer):
    loop = loop_of(joints, ramp=0.0)
    loop.is_frozen = True
    run(loop, 3)
    loop.controller.answer = None if answer is None else np.array(answer)
    np.testing.assert_array_equal(run(loop, 4, begin=1.0)[-1], [8.0, -4.0])
    assert loop.failures == 4
    loop.controller.answer = np.array([1.0, 1.0])
    np.testing.assert_array_equal(run(loop, 1, begin=2.0)[0], [1.0, 1.0])
    assert loop.failures == 0
    fresh = loop_of(joints)
    fresh.controller.answer = None
    with pytest.raises(SolveError):
        run(fresh, 1)


def test_the_memory_of_a_law_integrates_unless_nobody_hears_it(joints):
    loop = loop_of(joints, (0.0, 0.0), ramp=0.0)
    np.testing.assert_allclose(run(loop, 101)[-1], [0.099, 0.099])  # of the first 99 ms
    loop.is_frozen = True
    np.testing.assert_allclose(run(loop, 101, begin=0.101)[-1], [0.1, 0.1])
    loop.replace(Scripted(joints, (1.0, 1.0)))
    np.testing.assert_allclose(run(loop, 1, begin=0.3)[-1], [1.1, 1.1])
    loop.lapse(0.01)
    np.testing.assert_allclose(run(loop, 1, begin=0.4)[-1], [1.0, 1.0])  # a new beginning


def test_the_last_command_is_the_safe_one(joints):
    loop = loop_of(joints, safe=SafeCommand("damping", 2.0), limit=[1.5, 100.0])
    x = next(states(v=(0.5, -1.0)))
    loop.update(x)
    mobility = joints.response(x).mobility
    damping = -np.linalg.solve(np.eye(2) / 2.0 + 0.05 * mobility, x.v)
    np.testing.assert_allclose(loop.stop(True), np.clip(damping, [-1.5, -100], [1.5, 100]))
    np.testing.assert_array_equal(loop.stop(False), [0.0, 0.0])
    assert loop.lapse(0.01) is None


@pytest.mark.parametrize("effort", [(1e6, -1e6), (8.0, -4.0)])
def test_a_hand_over_is_a_ramp_however_far_beyond_its_limits_the_law_is(joints, effort):
    loop = loop_of(joints, effort, limit=[60.0, 60.0])
    loop.is_frozen = True
    taken = run(loop, 200)
    assert np.abs(np.diff(taken, axis=0)).max() <= 60.0 * DT / 0.1 + 1e-9
    falling = [taken[-1]]
    while (sent := loop.lapse(0.01)) is not None:
        falling.append(sent)
    assert np.abs(np.diff(falling, axis=0)).max() <= 60.0 * 0.01 / 0.1 + 1e-9


def test_a_reset_before_a_lapse_is_no_other_simulation(joints):
    loop = loop_of(joints)
    loop.is_frozen = True
    run(loop, 200)
    loop.restart()
    half = loop.lapse(0.05)
    np.testing.assert_allclose(half, [4.0, -2.0])
    back = run(loop, 100, begin=0.0)
    assert np.abs(np.diff([half, *back], axis=0)).max() <= 8.0 * DT / 0.1 + 1e-12
    np.testing.assert_allclose(back[-1], [8.0, -4.0])


def test_a_reset_goes_on_from_the_last_command_or_ramps_down(joints):
    loop = loop_of(joints)
    loop.is_frozen = True
    run(loop, 200)
    loop.restart()
    np.testing.assert_allclose(run(loop, 1, begin=0.0)[0], [8.0, -4.0])
    loop.restart()
    first = loop.lapse(0.01)
    np.testing.assert_allclose(first, [7.2, -3.6])
    while (sent := loop.lapse(0.01)) is not None:
        first = sent
    assert not first.any()
    assert loop.lapses == 1


def test_stamps_that_jump_ahead_go_on_without_a_bump(joints):
    loop = loop_of(joints, (0.0, 0.0), ramp=0.0)
    loop.generator.follow(0.0, np.array([0.0, 8.0]), np.array([[0.3, 0.1], [1.1, 0.1]]))
    last = run(loop, 101)[-1]
    assert last.any()
    np.testing.assert_allclose(run(loop, 1, 7.0)[0], last, atol=0.05 + 1e-12)  # memory is kept
    np.testing.assert_allclose(loop.generator.at(7.0).q, [0.3, 0.1], atol=1e-12)


def test_stamps_that_jump_back_begin_anew_by_the_ramp(joints):
    """Integrals are reset, the robot is held where it is, and effort comes as at a start."""
    loop, fresh = (loop_of(joints, (0.0, 0.0), ramp=0.1) for _ in range(2))
    loop.generator.follow(0.0, np.array([0.0, 8.0]), np.array([[0.3, 0.1], [1.1, 0.1]]))
    assert run(loop, 301)[-1].any()
    again = run(loop, 150, -3.0)
    assert not again[0].any() and again[-1].any()
    np.testing.assert_array_equal(again, run(fresh, 150, -3.0))


def test_a_loop_that_takes_over_goes_on_where_the_other_was(joints):
    loop = loop_of(joints, (1.0, -1.0), ramp=0.0)
    loop.generator.follow(0.0, np.array([0.0, 1.0]), np.array([[0.3, 0.1], [1.1, 0.1]]))
    last = run(loop, 101)[-1]
    other = loop_of(joints, (1.0, -1.0), ramp=0.0)
    other.take_over(loop)
    np.testing.assert_allclose(run(other, 1, begin=0.101)[0], last, atol=2e-3)
    np.testing.assert_array_equal(other.generator.at(0.4).q, loop.generator.at(0.4).q)


def test_what_is_not_finite_is_no_safe_command(joints):
    loop = loop_of(joints, safe=SafeCommand("damping", 10.0), limit=[np.inf, np.inf])
    x = next(states(v=(0.0, 0.0)))
    loop.update(x)
    loop._v = np.full(2, 1e308)
    assert not loop.stop(True).any()


# ---------------------------------------------------------------------- references by name


def coupled():
    robot = read_robot(chain(5))
    laws = {
        "joint_2": Coupling("joint_1", Linear(2.0, 0.5)),
        "joint_3": Coupling("joint_2", Linear(-1.0, 0.1)),
        "joint_5": Coupling("joint_4", Polynomial([0.0, 1.0, 0.5])),
    }
    return ReferenceMap(["joint_1", "joint_4"], Couplings(robot, laws))


def test_references_in_any_order_and_of_joints_that_follow():
    chosen = coupled().select(["joint_4", "joint_3"])  # joint_3 = -(2 z + 0.5) + 0.1
    np.testing.assert_allclose(chosen.positions(np.array([0.7, -1.0])), [0.3, 0.7])
    np.testing.assert_allclose(chosen.rates(np.array([[0.7, -1.0]])), [[0.5, 0.7]])
    assert chosen.note == "joint_1 from joint_3"
    chosen = coupled().select(["joint_2", "joint_4", "joint_1"])
    np.testing.assert_allclose(chosen.positions(np.array([9.0, 0.7, 0.3])), [0.3, 0.7])
    assert chosen.note == "joint_2 left out: it follows"


@pytest.mark.parametrize(
    ("names", "message"),
    [
        (["joint_1", "joint_5"], "joint_4 is missing"),  # joint_5 does not say where joint_4 is
        (["joint_1"], "joint_4 is missing"),
        (["joint_1", "joint_4", "joint_9"], "joint_9 not controlled; accepted: joint_1, joint_4"),
        (["joint_1", "joint_1", "joint_4"], "repeated"),
        ([], "empty"),
    ],
)
def test_references_that_leave_a_joint_open_are_refused(names, message):
    with pytest.raises(TargetError, match=message):
        coupled().select(names)
