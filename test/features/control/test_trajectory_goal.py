"""Goals of trajectories without ROS: tolerances, verdicts, and which joints a reference gives."""

import numpy as np
import pytest

from mbd_ros.features.control.reference import ReferenceMap
from mbd_ros.features.control.trajectory import (
    JointTolerance,
    ResultCode,
    TargetError,
    Tolerances,
    TrajectoryGoal,
)
from mbd_ros.methods.control.contract import Reference
from mbd_ros.scene.reader import load_scene

NAMES = ("hip", "knee")
ANY = np.full(2, np.inf)
NONE = Tolerances(ANY, ANY, ANY, ANY, np.inf)
REST = np.zeros(2)


def judged(tolerances, t, q, v=REST, ref=REST, rest=2.0):
    """Of a goal from 1 s to 2 s, its reference at rest."""
    goal = TrajectoryGoal(NAMES, tolerances, 1.0, 2.0, rest)
    return goal.judge(t, np.array(q), np.array(v), Reference(np.array(ref), REST, REST))


def test_on_the_way_only_the_path_counts():
    path = NONE._replace(path_q=np.array([0.1, np.inf]), goal_q=np.array([1e-9, 1e-9]))
    assert judged(path, 1.5, [0.1, 5.0]) is None
    outcome = judged(path, 1.5, [0.11, 5.0])
    assert outcome.code == ResultCode.PATH_TOLERANCE_VIOLATED
    assert "0.500 s after the begin: hip is 0.11 off, accepted 0.1" in outcome.text
    fast = judged(NONE._replace(path_v=np.array([np.inf, 2.0])), 1.0, REST, v=[9.0, -2.5])
    assert "knee is 2.5/s off, accepted 2/s" in fast.text


def test_the_end_is_reached_when_everything_is_within_or_missed_after_its_time():
    within = NONE._replace(goal_q=np.full(2, 0.1), goal_v=np.full(2, 0.01), time=0.5)
    assert judged(within, 2.0, [0.1, -0.1]).code == ResultCode.SUCCESSFUL
    assert judged(within, 2.5, [0.2, 0.0]) is None
    assert judged(within, 2.5, [0.0, 0.0], v=[0.02, 0.0]) is None
    missed = judged(within, 2.51, [0.0, 0.2])
    assert missed.code == ResultCode.GOAL_TOLERANCE_VIOLATED
    assert "0.510 s after the end of the trajectory, knee is 0.2 off" in missed.text
    assert judged(NONE, 2.0, [5.0, 5.0]).code == ResultCode.SUCCESSFUL
    assert judged(within._replace(time=np.inf), 1e6, [5.0, 5.0]) is None


def test_a_reference_that_still_ramps_to_the_end_is_not_there():
    assert judged(NONE, 2.0, REST, rest=2.3) is None
    assert judged(NONE, 2.3, REST, rest=2.3).code == ResultCode.SUCCESSFUL
    late = judged(NONE._replace(time=0.1), 2.2, REST, rest=2.3)
    assert late.code == ResultCode.GOAL_TOLERANCE_VIOLATED and "ramped" in late.text


def test_zero_leaves_the_default_a_negative_number_lifts_it():
    default = Tolerances(*(np.array([k, k + 1.0]) for k in (1.0, 3.0, 5.0, 7.0)), 9.0)
    path = [JointTolerance("knee", 0.5, -1.0, 0.0)]
    goal = [JointTolerance("hip", -1.0, 0.25, -1.0)]
    found = default.of_goal(NAMES, path, goal, -1.0)
    assert found.path_q.tolist() == [1.0, 0.5] and found.path_v.tolist() == [3.0, np.inf]
    assert found.goal_q.tolist() == [np.inf, 6.0] and found.goal_v.tolist() == [0.25, 8.0]
    assert found.time == np.inf and default.of_goal(NAMES, [], [], 0.0).time == 9.0
    assert default.of_goal(NAMES, [], [], 0.2).time == 0.2
    assert default.path_q.tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (
            ("toe", 0.1, 0.0, 0.0),
            "'toe': the joint is not controlled; accepted: hip, knee",
        ),
        (("hip", np.nan, 0.0, 0.0), "path_tolerance of 'hip': position is not a number"),
        (("hip", 0.1, np.nan, 0.0), "path_tolerance of 'hip': velocity is not a number"),
        (("hip", 0.1, 0.0, 2.0), "acceleration 2; accepted: 0"),
        (("hip", 0.1, 0.0, np.nan), "acceleration nan; accepted: 0"),
    ],
)
def test_tolerances_that_mean_nothing_are_refused(given, reason):
    with pytest.raises(TargetError, match="goal refused") as caught:
        NONE.of_goal(NAMES, [JointTolerance(*given)], [], 0.0)
    assert reason in str(caught.value)


# ---------------------------------------------------------------------- some of the joints


@pytest.fixture
def leg():
    """hip, knee and ankle are controlled; two slides follow the knee by polynomials or splines."""
    scene = load_scene("package://mbd_ros/config/scenes/controlled_leg.yaml")
    return scene, ReferenceMap(scene.controlled_joints().names, scene.couplings)


def test_joints_that_are_left_out_are_named_and_the_order_is_free(leg):
    scene, mapped = leg
    names = scene.controlled_joints().names
    some = mapped.select([names[2], names[0]], partial=True)
    assert some.is_given.tolist() == [True, False, True]
    values = np.array([[0.3, 0.1]])
    assert some.positions(values)[0][[0, 2]].tolist() == [0.1, 0.3]
    assert f"{names[1]} held: not given" in some.note
    with pytest.raises(TargetError, match=f"{names[1]} is missing"):
        mapped.select([names[2], names[0]])


def test_a_joint_that_follows_one_left_out_is_refused_not_ignored(leg):
    scene, mapped = leg
    slide = scene.couplings.dependent[0]
    names = scene.controlled_joints().names
    root = scene.couplings.parents[slide]
    rest = [name for name in names if name != root]
    with pytest.raises(TargetError, match=f"{slide} follows {root}"):
        mapped.select([slide, *rest], partial=True)
    assert f"{slide} left out" in mapped.select([slide, root], partial=True).note
