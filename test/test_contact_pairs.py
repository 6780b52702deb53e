"""Features of pairs of shapes: gaps in closed form, Jacobian and drift against differences."""

import mechanisms
import numpy as np
import pinocchio as pin
import pytest
from mechanisms import scene_of

from mbd_ros.core.model.kinematics import Kinematics
from mbd_ros.core.state import State

BODIES = """
bodies:
  box: {shape: {box: [0.2, 0.3, 0.4]}, mass: 2.0, pose: {xyz: [0.1, 0.2, 0.9]}}
  ball: {shape: {sphere: 0.1}, mass: 1.0, pose: {xyz: [0.5, -0.4, 0.3]}}
  pill: {shape: {capsule: {radius: 0.05, length: 0.3}}, mass: 1.0}
  wedge: {shape: {box: [1, 1, 1]}, mass: 7.0, pose: {xyz: [0.0, 0.0, -1.0]}}
"""
PLANE = "{frame: wedge, half_space: [0.2, -0.1, 1.0], xyz: [0.1, 0.0, 0.5], rpy: [0.1, 0.2, 0.3]}"
POINTS = "{frame: pill, points: [[0.1, 0, 0], [0, 0.2, 0.1], [0.1, 0.1, 0.3]], rpy: [1, 0, 0]}"
SMOOTH = {  # a, b and the names of the features
    "sphere over plane": ("ball", PLANE, 1),
    "plane over sphere": (PLANE, "ball", 1),
    "points over plane": (POINTS, PLANE, 3),
    "plane over points": (PLANE, POINTS, 3),
    "capsule over plane": ("pill", PLANE, 2),
    "box over plane": ("box", PLANE, 8),
    "box over ground": ("box", "ground", 8),
    "ground over box": ("ground", "box", 8),
    "ball over ball": ("ball", "{frame: box, sphere: 0.3, xyz: [0.1, 0, 0]}", 1),
    "points over ball": (POINTS, "ball", 3),
}
PLACES = {"near": (0.0, 0.0, 0.0), "far": (100.0, -60.0, 30.0)}


def pair_of(a, b, more=""):
    entry = f"{{type: rigid, between: [{a}, {b}], friction: 0.5{more}}}"
    scene = scene_of(f"{BODIES}contacts: [{entry}]\n")
    (part,) = scene.constraints
    return scene, part.pair


def random_states(scene, count, place=(0.0, 0.0, 0.0), seed=0):
    model, rng = scene.robot.model, np.random.default_rng(seed)
    for _ in range(count):
        q = scene.initial.q.copy()
        for base in scene.robot.bases:
            q[base.q][:3] += place
        yield State(
            0.0, pin.integrate(model, q, rng.uniform(-1, 1, model.nv)), rng.normal(size=model.nv)
        )


def at(scene, pair, x, shift=0.0):
    """What the pair says a little later on a motion without joint accelerations."""
    k = Kinematics(scene.robot)
    q = pin.integrate(scene.robot.model, x.q, shift * x.v)
    k.refresh(q, x.v)
    return k, x._replace(q=q)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("case", SMOOTH)
def test_rows_are_the_derivatives_of_gaps_and_of_one_another(case, place):
    a, b, count = SMOOTH[case]
    scene, pair = pair_of(a, b)
    assert len(pair.features) == len(set(pair.features)) == count
    assert pair.is_smooth and not pair.why_not
    h = 1e-6
    tolerance = 1e-7 * (1.0 + 10.0 * np.abs(PLACES[place]).max())
    for x in random_states(scene, 5, PLACES[place]):
        before, after = (at(scene, pair, x, shift) for shift in (-h, h))
        k, x = at(scene, pair, x)
        rates = pair.jacobian(k) @ x.v
        slope = (pair.gaps(after[0]) - pair.gaps(before[0])) / (2.0 * h)
        k, x = at(scene, pair, x)
        assert slope == pytest.approx(rates[::3], abs=tolerance)
        slopes = [pair.jacobian(near) @ x.v for near, _ in (before, after)]
        drift = pair.drift(k, x)
        size = 1.0 + np.abs(drift).max()
        assert (slopes[1] - slopes[0]) / (2.0 * h) == pytest.approx(drift, abs=tolerance * size)


@pytest.mark.parametrize("case", SMOOTH)
def test_rows_are_velocities_of_a_past_b_at_the_contact_point(case):
    """From the velocities of both bodies alone, which this test asks Pinocchio for."""
    a, b, _ = SMOOTH[case]
    scene, pair = pair_of(a, b)
    for x in random_states(scene, 3):
        k, x = at(scene, pair, x)
        point, axes = pair.places(k)
        data = scene.robot.model.createData()
        pin.forwardKinematics(scene.robot.model, data, x.q, x.v)
        speeds = []
        for side in pair.between:
            joint = scene.robot.model.frames[scene.robot.frame(side.frame)].parentJoint
            motion = data.oMi[joint].act(data.v[joint])
            speeds.append(motion.linear + np.cross(motion.angular, point))
        past = np.einsum("nij,ni->nj", axes, speeds[0] - speeds[1])
        assert pair.jacobian(k) @ x.v == pytest.approx(past[:, [2, 0, 1]].ravel(), abs=1e-12)
        assert np.einsum("nij,nik->njk", axes, axes) == pytest.approx(
            np.broadcast_to(np.eye(3), axes.shape), abs=1e-13
        )
        assert np.linalg.det(axes) == pytest.approx(np.ones(len(axes)))


def test_both_orders_of_a_pair_say_the_same():
    """Gaps are equal and normals opposite, whichever of two bodies is called a."""
    for a, b in (("ball", PLANE), ("box", PLANE)):
        scene, pair = pair_of(a, b)
        other, back = pair_of(b, a)
        for x in random_states(scene, 3):
            (k, _), (other_k, _) = at(scene, pair, x), at(other, back, x)
            assert pair.gaps(k) == pytest.approx(back.gaps(other_k), abs=1e-14)
            one, two = pair.places(k), back.places(other_k)
            assert one.point == pytest.approx(two.point, abs=1e-14)
            assert one.axes[:, :, 2] == pytest.approx(-two.axes[:, :, 2], abs=1e-14)


def test_gaps_are_those_of_hand():
    """Bodies stand where `BODIES` puts them, without rotation."""
    expected = {
        ("box", "ground"): [0.7] * 4 + [1.1] * 4,
        ("ball", "ground"): [0.2],
        ("pill", "ground"): [-0.2, 0.1],
        ("ball", "{sphere: 0.2, xyz: [0.5, -0.4, 1.0]}"): [0.4],
        ("{frame: ball, points: [[0.1, 0, 0], [0, 0, -0.4]]}", "ground"): [0.3, -0.1],
    }
    for (a, b), gaps in expected.items():
        scene, pair = pair_of(a, b)
        k, _ = at(scene, pair, scene.initial)
        assert pair.gaps(k) == pytest.approx(gaps, abs=1e-14)
        scene, pair = pair_of(a, b, ", margin: 0.01")
        k, _ = at(scene, pair, scene.initial)
        assert pair.gaps(k) == pytest.approx(np.array(gaps) - 0.01, abs=1e-14)


def test_frames_that_do_not_move_against_each_other_are_refused():
    arm = mechanisms.chain(2)
    for a, b in (("{points: [[0, 0, 1]]}", "ground"), ("{frame: rod_1, sphere: 1}",) * 2):
        text = f"contacts: [{{type: rigid, between: [{a}, {b}], friction: 0}}]"
        with pytest.raises(Exception, match=r"contacts\[0\].*do not move against each other"):
            scene_of(text, arm)
