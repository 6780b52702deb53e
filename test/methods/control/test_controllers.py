"""Control laws at single states, and the functions that they are made of."""

import re

import numpy as np
import pytest
from mechanisms import scene_of
from places import ROOT

from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SolveError
from mbd_ros.methods.control.contract import EffortBox, Reference, Response, per_joint
from mbd_ros.methods.control.efforts import MobilityFactor
from mbd_ros.methods.control.sliding_mode import mismatch, sliding_variable
from mbd_ros.parts.forces.joint_torque import JointTorque
from mbd_ros.scene.schema import schema
from mbd_ros.scene.schema.registry import resolve

CONFIG = ROOT / "config"
FOUR_BAR = ("knee_anterior", "knee_tibial", "knee_posterior")
ACTUATED = {
    "prosthetic_arm": "shoulder_flexion, shoulder_abduction, wrist_rotation, wrist_flexion",
    "prosthetic_leg": "hip_flexion, knee, ankle",
    "four_bar_leg": "hip_flexion, knee_anterior, ankle",
    "five_drives": f"hip_flexion, {', '.join(FOUR_BAR)}, ankle",
}
GAINS = {
    "sliding_mode": {"bandwidth": 10.0, "gain": 60.0, "boundary_layer": 0.1},
    "super_twisting": {"bandwidth": 10.0, "disturbance_rate": 500.0},
    "computed_torque": {"kp": 100.0, "kd": 20.0},
    "gravity_compensation": {"stiffness": 5.0, "damping": 0.5},
}
each_law = pytest.mark.parametrize("name", GAINS)
each_mechanism = pytest.mark.parametrize("mechanism", ACTUATED)


@pytest.fixture
def scene():
    """A scene of this package with ideal actuators."""

    def load(mechanism):
        file = "four_bar_leg" if mechanism == "five_drives" else mechanism
        text = (CONFIG / f"scenes/{file}.yaml").read_text(encoding="utf-8")
        text = re.sub(r"(?m)^actuators:.*\n(-.*\n)*", "", text)
        text = text.replace("../robots", str(CONFIG / "robots"))
        actuators = f"actuators: [{{type: ideal, joints: [{ACTUATED[mechanism]}]}}]\n"
        return scene_of(f"{text}\n{actuators}")

    return load


def built(name, joints, **gains):
    return resolve("controllers", name, "test")(joints, **{**GAINS[name], **gains})


def free(n):
    return EffortBox(np.full(n, -np.inf), np.full(n, np.inf))


def consistent(loaded, rng):
    """A moving state on the constraints, near the initial one."""
    simulation, model = loaded.simulation(), loaded.robot.model
    q = loaded.initial.q + 0.05 * rng.normal(size=model.nq)
    y = simulation.start(State(0.0, q, rng.normal(size=model.nv)))
    return simulation.system.expand(y)


def near(joints, x, rng):
    """A reference near a state."""
    q, v, a = rng.normal(size=(3, len(joints)))
    return Reference(joints.positions(x) + 0.1 * q, joints.velocities(x) + v, 5.0 * a)


def accelerations(loaded, joints, x, effort):
    """Of the controlled joints, by the system of the simulation, not that of the controller."""
    system = loaded.system()
    a = system.evaluate(x, effort).a
    return a[[joint.v for joint in joints.joints]]


# ---------------------------------------------------------------------- without errors


@each_mechanism
@each_law
def test_the_equivalent_effort_keeps_s_and_the_law_does_what_it_says(scene, mechanism, name):
    """By the true system; where five drives move three freedoms, as far as they can."""
    loaded, rng = scene(mechanism), np.random.default_rng(1)
    joints = loaded.controlled_joints()
    controller, n = built(name, joints), len(joints)
    lam = 5.0 if name == "computed_torque" else 10.0
    for _ in range(5):
        x = consistent(loaded, rng)
        ref = near(joints, x, rng)
        control = controller.effort(x, ref, controller.begin(), free(n))
        e, rate = joints.positions(x) - ref.q, joints.velocities(x) - ref.v
        np.testing.assert_allclose(control.s, rate + lam * e, rtol=1e-12)
        if name == "gravity_compensation":
            still = x._replace(v=np.zeros_like(x.v))
            a = accelerations(loaded, joints, still, control.equivalent)
            np.testing.assert_allclose(a, 0.0, rtol=0, atol=1e-9)
            expected = control.equivalent - 5.0 * e - 0.5 * rate
            np.testing.assert_allclose(control.effort, expected, rtol=1e-9, atol=1e-12)
            continue
        a = accelerations(loaded, joints, x, control.effort)
        demanded = {
            "sliding_mode": -lam * rate - 60.0 * np.clip(control.s / 0.1, -1.0, 1.0),
            "super_twisting": -lam * rate
            - 3.0 * np.sqrt(500.0 * np.abs(control.s)) * np.sign(control.s),
            "computed_torque": -20.0 * rate - 100.0 * e,
        }[name]
        kept = accelerations(loaded, joints, x, control.equivalent)
        reach = MobilityFactor(joints.response(x).mobility).reachable
        np.testing.assert_allclose(reach(kept - ref.a + lam * rate), 0.0, rtol=0, atol=1e-9)
        np.testing.assert_allclose(reach(a - ref.a - demanded), 0.0, rtol=0, atol=1e-9)


def test_five_drives_of_three_freedoms_share_with_the_least_effort(scene):
    """Closed form: of all efforts with the same motion, the pseudo-inverse gives the shortest."""
    loaded, rng = scene("five_drives"), np.random.default_rng(2)
    joints = loaded.controlled_joints()
    x = consistent(loaded, rng)
    A = joints.response(x).mobility
    assert np.linalg.matrix_rank(A, tol=1e-9 * np.linalg.norm(A)) == 3
    factor, a = MobilityFactor(A), rng.normal(size=5)
    assert not factor.is_regular
    expected = np.linalg.lstsq(A, a, rcond=1e-9)[0]
    np.testing.assert_allclose(factor.solve(a), expected, rtol=1e-8)
    np.testing.assert_allclose(factor.reachable(a), A @ expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("name", ["sliding_mode", "super_twisting"])
def test_five_drives_reject_an_unknown_torque_together(scene, name):
    """Steady state in closed form: the layer leaves e = phi d / (k lambda), w becomes -d."""
    loaded, dt = scene("five_drives"), 1e-3
    joints = loaded.controlled_joints()
    controller, goal = built(name, joints), consistent(loaded, np.random.default_rng(8))
    unknown = JointTorque(loaded.robot, joint="hip_flexion", torque=5.0)
    simulation = loaded.simulation(dt=dt, forces=[unknown])
    ref = Reference(joints.positions(goal), *np.zeros((2, 5)))
    y, memory = simulation.start(loaded.initial), controller.begin()
    for k in range(1500):
        x = simulation.system.expand(y)
        control = controller.effort(x, ref, memory, free(5))
        memory = memory + dt * control.memory_rate
        y = simulation.advance(y, control.effort, (k + 1) * dt)
    A = joints.response(x).mobility
    d, e = 5.0 * A[:, joints.names.index("hip_flexion")], joints.positions(x) - ref.q
    if name == "sliding_mode":
        np.testing.assert_allclose(e, 0.1 * d / (60.0 * 10.0), rtol=0, atol=1e-5)
    else:
        step = 2.5 * 500.0 * dt  # of w
        np.testing.assert_allclose(e, 0.0, rtol=0, atol=step * dt)
        reached = MobilityFactor(A).reachable(memory)
        np.testing.assert_allclose(reached, -d, rtol=0, atol=4.0 * step)
        assert np.abs(memory).max() <= 2.0 * np.abs(d).max()  # nothing piles up out of reach


@pytest.mark.parametrize("size", [1e-300, 1e-12, 0.0, -1e-17])
def test_what_no_effort_moves_is_left_out(size):
    """Near a toggle the effort does not grow; rounding may make an eigenvalue negative."""
    A = np.diag([2.0, size, 0.5])
    np.testing.assert_array_equal(MobilityFactor(A).solve(np.array([4.0, 1.0, 1.0])), [2, 0, 2])
    one = MobilityFactor(np.array([[size]])).solve(np.array([1.0]))
    assert one.shape == (1,) and one[0] == pytest.approx(1.0 / size if size > 0 else 0.0)


def test_a_mobility_that_is_not_finite_is_said_so():
    with pytest.raises(SolveError, match="mobility of the controlled joints is not finite"):
        MobilityFactor(np.full((3, 3), np.nan))


def test_mismatch_tells_what_the_law_is_left_with():
    """Closed form for one joint: m a = tau + d - g against a model m_m a = tau - g_m."""
    m, g, d, m_m, g_m, keep, rho = 2.0, 3.0, 0.4, 2.6, 3.9, 1.5, 7.0
    truth, model = (
        Response(*np.zeros((2, 1)), np.array([-w / i]), np.array([[1.0 / i]]))
        for i, w in ((m, g), (m_m, g_m))
    )
    left = mismatch(truth, model, np.array([keep]), np.array([d]))
    tau = m_m * (keep - rho) + g_m
    slope = (tau + d - g) / m - keep
    assert left.disturbance - left.effectiveness[0] * rho == pytest.approx(slope)


# ---------------------------------------------------------------------- gains and values


@pytest.mark.parametrize(
    ("name", "gains", "reason"),
    [
        ("sliding_mode", {"bandwidth": 0.0}, r"bandwidth 0.0 must be finite and > 0"),
        ("sliding_mode", {"gain": -1.0}, r"gain -1.0 must be finite and > 0"),
        ("sliding_mode", {"boundary_layer": -0.1}, r"boundary_layer -0.1 must be .* >= 0"),
        ("sliding_mode", {"boundary_layer": np.nan}, r"boundary_layer nan must be finite"),
        ("sliding_mode", {"law": "linear"}, r"law 'linear', accepted: constant, exponential, po"),
        ("sliding_mode", {"law": "power_rate", "power": 1.0}, r"power 1 must be > 0 and < 1"),
        ("sliding_mode", {"law": "exponential", "rate": 0.0}, r"rate 0.0 must be finite and > 0"),
        ("sliding_mode", {"gain": [1.0, 2.0]}, r"gain has 2 values; accepted: one, .*joint \(4"),
        ("super_twisting", {"disturbance_rate": np.inf}, r"disturbance_rate inf must be finite"),
        ("super_twisting", {"integral": 1.0}, r"integral 1.0 must be finite and > 1"),
        ("super_twisting", {"proportional": 0.0}, r"proportional 0.0 must be finite and > 0"),
        ("computed_torque", {"kp": -1.0}, r"kp -1.0 must be finite and > 0"),
        ("computed_torque", {"kd": [1.0, 1.0, 1.0, 0.0]}, r"kd \[1.0, .*\] must be finite and > "),
        ("gravity_compensation", {"stiffness": 0.0}, r"stiffness 0.0 must be finite and > 0"),
        ("gravity_compensation", {"damping": np.nan}, r"damping nan must be finite and > 0"),
    ],
)
def test_a_bad_gain_is_refused_with_what_is_accepted(scene, name, gains, reason):
    joints = scene("prosthetic_arm").controlled_joints()
    with pytest.raises(ModelError, match=reason):
        built(name, joints, **gains)


@each_law
def test_laws_are_values(scene, name):
    """Nothing is written, nothing remembered; other gains are another law of the same joints."""
    loaded, rng = scene("prosthetic_arm"), np.random.default_rng(3)
    joints = loaded.controlled_joints()
    x, other = (consistent(loaded, rng) for _ in range(2))
    ref, box = near(joints, x, rng), free(4)
    controller, memory = built(name, joints), rng.normal(size=4)
    for values in (x.q, x.v, *ref, memory, *box):
        values.flags.writeable = False
    first = controller.effort(x, ref, memory, box)
    stiffer = built(name, joints, **{next(iter(GAINS[name])): 30.0})
    assert not np.array_equal(stiffer.effort(x, ref, memory, box).effort, first.effort)
    controller.effort(other, ref, memory, box)
    for before, after in zip(first, controller.effort(x, ref, memory, box), strict=True):
        assert before is not after and np.array_equal(before, after)
    assert len(first.memory_rate) == len(controller.begin())
    assert first.active.shape == (len(controller.limit_names),)


@each_law
def test_gains_may_differ_from_joint_to_joint(scene, name):
    """As one value a joint they say the same as one for all."""
    loaded, rng = scene("prosthetic_arm"), np.random.default_rng(4)
    joints = loaded.controlled_joints()
    x = consistent(loaded, rng)
    ref, memory = near(joints, x, rng), rng.normal(size=4)
    one = built(name, joints)
    many = built(name, joints, **{key: [value] * 4 for key, value in GAINS[name].items()})
    for a, b in zip(*(law.effort(x, ref, memory, free(4)) for law in (one, many)), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("size", [0.0, 5e-324, 1e-150, 1e6, 1e100])
@each_law
def test_finite_in_finite_out(scene, name, size):
    joints = scene("prosthetic_arm").controlled_joints()
    zeros, ones = np.zeros(4), np.ones(4)
    x = State(0.0, size * np.ones(5), size * np.ones(5))
    for ref in (Reference(zeros, zeros, zeros), Reference(size * ones, size * ones, -size * ones)):
        control = built(name, joints).effort(x, ref, size * ones, free(4))
        assert all(np.isfinite(values).all() for values in control)


def test_gains_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        per_joint(1.0, 3, "gain")[0] = 2.0
    assert per_joint([0.0, 1.0], 2, "layer", least=0.0).tolist() == [0.0, 1.0]


def test_the_sliding_variable_bounds_the_error():
    """e' + lambda e = w cos: |e| <= w / lambda and |e'| <= 2 w, in its steady state."""
    lam, w = 5.0, 0.3
    for omega in (0.1, 5.0, 100.0):
        e = w / abs(lam + 1j * omega)
        assert e <= w / lam and omega * e <= 2.0 * w
    r = Response(np.array([0.2]), np.array([0.1]), np.zeros(1), np.eye(1))
    s, keep = sliding_variable(r, Reference(*np.ones((3, 1))), np.array([lam]))
    assert (s[0], keep[0]) == pytest.approx((-0.9 - 4.0, 1.0 + 4.5))


def test_the_integral_does_not_wind_up_against_the_effort_box(scene):
    """Held back upwards, w may fall but not rise; inside the box it moves freely."""
    loaded, rng = scene("prosthetic_arm"), np.random.default_rng(6)
    joints = loaded.controlled_joints()
    controller, x = built("super_twisting", joints), consistent(loaded, rng)
    ref, memory = near(joints, x, rng), np.zeros(4)
    free_rate = controller.effort(x, ref, memory, free(4)).memory_rate
    s = controller.effort(x, ref, memory, free(4)).s
    np.testing.assert_array_equal(free_rate, -1250.0 * np.sign(s))
    wanted = controller.effort(x, ref, memory, free(4)).effort
    A = joints.response(x).mobility
    for clipped in (wanted - 0.1, wanted + 0.1):
        rate = controller.effort(x, ref, memory, EffortBox(clipped, clipped)).memory_rate
        denied = A @ (wanted - clipped)
        np.testing.assert_array_equal(rate, np.where(denied * free_rate > 0.0, 0.0, free_rate))


def test_gains_come_from_yaml(scene):
    joints = scene("prosthetic_arm").controlled_joints()
    part = resolve("controllers", "sliding_mode", "test")
    assert schema.call(part, dict(part.example), "test", joints).joints is joints
