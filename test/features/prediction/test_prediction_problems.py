"""Predictions against costs that others found, and tasks of this package."""

import prediction_problems as problems
import pytest

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import OK

CASES = {
    "swing_up": (problems.swing_up, 1.0e-8),
    "coupled_arm": (problems.coupled_arm, 1.0e-8),
    "coupled_arm_one_torque": (lambda: problems.coupled_arm(("q0",), 1857.5141647728), 1.0e-8),
    "four_bar": (problems.four_bar, 1.0e-8),
    "rigid_tendon": (problems.hanging_muscle, 1.0e-8),
    "elastic_tendon": (lambda: problems.hanging_muscle("elastic"), 1.0e-6),
    "hopper": (problems.hopper, 1.0e-6),
}
PUBLISHED = {"five_link_biped": 469.5019750705, "hopper": 1153.647245172}


@pytest.mark.parametrize("name", CASES)
def test_costs_are_those_of_two_other_methods(name):
    """On the mesh that refinement chose, and the controls lead to the end by another method."""
    make, accepted = CASES[name]
    scene, task, cost = make()
    found = scene.predict(task).metadata
    assert found["cost"] == pytest.approx(cost, rel=accepted)
    assert found["replay"] < 10.0 * found["error"]


@pytest.mark.parametrize(
    ("scene", "task"),
    [
        ("hopper", "hop"),
        ("five_link_biped", "biped_step"),
        ("prosthetic_leg_locked", "locked_leg_swing"),
        ("prosthetic_leg", "leg_swing"),
        pytest.param("prosthetic_arm", "arm_reach", marks=pytest.mark.soak),
        pytest.param("smooth_muscle_arm", "muscle_reach", marks=pytest.mark.soak),
    ],
)
def test_embedded_tasks_replay(scene, task, tmp_path):
    """The inputs lead to the end by dop853 too, within ten times the stated error."""
    out = tmp_path / "motion.npz"
    assert main(["predict", scene, task, "-o", str(out)]) == OK
    found = mbd.read_result(out).metadata
    assert found["converged"]
    if scene in PUBLISHED:
        assert found["cost"] == pytest.approx(PUBLISHED[scene], rel=1.0e-7)
    assert found["replay"] < 10.0 * found["error"]
