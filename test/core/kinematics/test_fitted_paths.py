"""Polynomials in place of paths that wrap, smooth muscles in place of others, in predictions."""

import numpy as np
import pytest
from prediction_problems import joint, link, urdf

import mbd_ros as mbd
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.kinematics.sampled_kinematics import SampledKinematics, carriers
from mbd_ros.core.state import State
from mbd_ros.errors import SceneError
from mbd_ros.features.prediction.smooth_scene import with_fitted_paths, with_smooth_muscles
from mbd_ros.scene.reading.path_entries import path_of

ARM = mbd.load_scene("smooth_muscle_arm").robot
POLYNOMIAL = {
    "joints": {"shoulder": [-1.0, 2.0], "elbow": [0.0, 2.5]},
    "terms": [[0, 0, 0.3], [1, 0, -0.04], [0, 3, 0.01], [2, 1, -0.02]],
}
ROLL = {"frame": "ground", "cylinder": {"radius": 0.03, "length": 0.4}, "side": "-x"}
SIZES = {
    "max_isometric_force": 600.0,
    "optimal_fiber_length": 0.1,
    "tendon_slack_length": 0.15,
    "pennation_angle": 0.1,
}


def elbow(tendon="rigid", **changes):
    """A forearm that hangs, with a flexor and an extensor that goes around a roll."""
    forearm = link("forearm", 1.5, "0 -0.15 0", 0.02)
    hinge = joint("elbow", "revolute", "ground", "forearm", "0 0 1")
    hinge = hinge.replace("lower='-100' upper='100'", "lower='-0.2' upper='2.3'")
    ends = [("ground", 0.2), ("forearm", -0.06)]
    front, back = ([{"frame": one, "xyz": [x, y, 0.0]} for one, y in ends] for x in (0.03, -0.02))
    shared = {"type": "thelen", "tendon": tendon, **SIZES}
    return mbd.scene_from(
        {
            "robot": {"gravity": [0.0, -9.81, 0.0]},
            "paths": {"back": {"points": back, "wraps": [ROLL]}},
            "muscles": [
                {**shared, "name": "flexor", "path": {"points": front}},
                {**shared, "name": "extensor", "path": "back"},
            ],
            "initial": {"position": {"elbow": 0.3}},
            **changes,
        },
        urdf=urdf(forearm, hinge),
    )


def reach(**changes):
    return {
        "duration": 0.5,
        "start": {"elbow.position": 0.3, "elbow.velocity": 0.0, "*.activation": 0.05},
        "end": {"elbow.position": 1.0, "elbow.velocity": 0.0},
        "goals": [{"type": "integral", "of": "*.excitation", "power": 2}],
        "muscles": "degroote_fregly",
        "tolerance": 1.0e-3,
        **changes,
    }


def at(q, v):
    k = Kinematics(ARM)
    k.refresh(q, v)
    return k, State(0.0, q, v)


def test_slopes_and_drift_of_a_polynomial_are_those_of_its_length():
    path = path_of(ARM, {"polynomial": POLYNOMIAL, "joints": {"elbow": 0.02}}, "here")
    q, v, h = np.array([0.4, 1.1]), np.array([0.7, -1.3]), 1.0e-5

    def moved(s):
        return path.measured(*at(q + s * v, v))

    length, slope = path.measured(*at(q, v))
    assert slope @ v == pytest.approx((moved(h)[0] - moved(-h)[0]) / (2 * h), rel=1.0e-8)
    bend = (moved(h)[1] - moved(-h)[1]) @ v / (2 * h)
    assert path.drift(*at(q, v)) == pytest.approx(bend, rel=1.0e-8)
    z = (2.0 * 0.4 - 1.0) / 3.0, (2.0 * 1.1 - 2.5) / 2.5  # T_3 = 4 z^3 - 3 z, T_2 = 2 z^2 - 1
    by_hand = 0.3 - 0.04 * z[0] + 0.01 * (4 * z[1] ** 3 - 3 * z[1])
    by_hand += -0.02 * (2 * z[0] ** 2 - 1) * z[1] + 0.02 * 1.1
    assert length == pytest.approx(by_hand, rel=1.0e-14)
    k = SampledKinematics(ARM, np.array([q, q + 0.1]), carriers(ARM))
    lengths, slopes = path.sampled(k)
    assert lengths[0] == pytest.approx(length, rel=1.0e-14)
    assert slopes[0] == pytest.approx(slope, rel=1.0e-14)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"joints": {"elbow": [1.0, 1.0]}}, "elbow: expected"),
        ({"terms": [[1, 0.3]]}, "2 exponents and a coefficient"),
        ({"terms": [[0.5, 0, 0.3]]}, "whole numbers"),
        ({"joints": {"elbo": [0.0, 1.0], "shoulder": [0.0, 1.0]}}, "elbo"),
    ],
)
def test_a_polynomial_of_another_form_is_refused(change, words):
    with pytest.raises(SceneError, match=words):
        path_of(ARM, {"polynomial": {**POLYNOMIAL, **change}}, "here")


def test_polynomials_are_as_near_to_paths_that_wrap_as_they_say():
    scene = elbow()
    fitted, lines, joints = with_fitted_paths(scene, {"elbow": (-0.2, 2.3)})
    assert joints == {"elbow"}
    assert len(lines) == 1
    off = []
    for angle in np.linspace(-0.15, 2.25, 41):
        k = Kinematics(scene.robot)
        q = np.array([angle])
        k.refresh(q, np.zeros(1))
        x = State(0.0, q, np.zeros(1))
        for old, new in zip(scene.muscles, fitted.muscles, strict=True):
            (length, slope), (other, arm) = (one.path.measured(k, x) for one in (old, new))
            off.append((length - other, float((slope - arm)[0])))
    length, arm = np.sqrt(np.mean(np.square(off[1::2]), axis=0))
    stated = float(lines[0].split("error of the length ")[1].split(" m")[0])
    assert length < 2.0 * stated < 1.0e-4  # of 0.3 m
    assert arm < 5.0e-4  # m of 0.03 m
    assert np.abs(off[::2]).max() == 0.0


@pytest.mark.parametrize("tendon", ["rigid", "elastic"])
def test_smooth_muscles_keep_sizes_and_their_balance_is_theirs(tendon):
    scene, line = with_smooth_muscles(elbow(tendon), {"damping": 0.0})
    assert line == "muscles: thelen -> degroote_fregly with damping 0.0"
    flexor = scene.muscles[0]
    assert (flexor.tendon, flexor.contraction.peak) == (tendon, 600.0)
    assert flexor.contraction.curves.tendon_strain == 0.04  # that of Thelen, not the usual 0.049
    assert flexor.dynamics.falling == 0.05
    random, k = np.random.default_rng(1), Kinematics(scene.robot)
    for _ in range(5):
        q = random.uniform(0.0, 1.2, 1)
        k.refresh(q, q)
        length = flexor.path.length(k, State(0.0, q, q))
        z = np.full(scene.internals.nz, 0.3)
        if tendon == "elastic":
            z[flexor.z.stop - 1] = flexor.stable_lengths(0.3, length)[0] * 0.99
        x, u = State(0.0, q, q, z), np.full(2, 0.6)
        rates = flexor.rates(k, x, u)
        assert flexor.balance(k, x, u, rates) == pytest.approx(np.zeros(len(rates)), abs=1.0e-9)
        assert np.abs(flexor.balance(k, x, u, rates + 0.5)).min() > 1.0e-6


@pytest.mark.parametrize("tendon", ["rigid", "elastic"])
def test_muscles_that_wrap_and_have_kinks_are_predicted(tendon):
    found = elbow(tendon).predict(reach())
    assert found.metadata["converged"]
    assert found.metadata["error"] < 1.0e-3
    assert found.metadata["replay"] < 1.0e-2
    assert len(found.metadata["changes"]) == 2
    if tendon == "rigid":
        finer = elbow(tendon).predict(reach(tolerance=1.0e-5))
        assert found.metadata["cost"] == pytest.approx(finer.metadata["cost"], rel=1.0e-3)


def test_a_joint_without_limits_is_held_near_what_the_task_names():
    found = elbow().predict(reach(bounds={"elbow.position": [-0.1, 1.5]}))
    text = found.metadata["changes"][-1]
    assert "elbow" in text
    angles = found.tables["samples"]["elbow.position"]
    assert angles.min() >= -0.1 - 1e-6


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ("thelen", "accepted are degroote_fregly"),
        ({"type": "degroote_fregly", "damping": "x"}, "damping"),
    ],
)
def test_other_words_for_muscles_are_refused(given, words):
    with pytest.raises(SceneError, match=words):
        elbow().predict(reach(muscles=given))


def test_muscles_are_asked_of_a_scene_without_any():
    with pytest.raises(SceneError, match="muscles: the scene has no muscles"):
        mbd.load_scene("cart_pole").predict({**reach(), "start": {}, "end": {}})
