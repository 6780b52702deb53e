"""Sliding mode control: its laws, and the prosthetic arm with a wrong model and a disturbance."""

import numpy as np
import pytest
from mechanisms import scaled, scene_of
from places import ROOT
from scipy.integrate import solve_ivp

from mbd_ros.core.contracts import Load
from mbd_ros.core.state import State
from mbd_ros.features.control.loop_watch import ChatterMeter
from mbd_ros.methods.control.contract import EffortBox, Reference
from mbd_ros.methods.control.sliding_mode import (
    LAWS,
    ReachingLaw,
    mismatch,
    reaching_time_bound,
    sliding_variable,
    super_twisting,
)
from mbd_ros.parts.controllers.computed_torque import ComputedTorque
from mbd_ros.parts.controllers.sliding_mode import SlidingMode
from mbd_ros.parts.controllers.super_twisting import SuperTwisting

ROBOTS = ROOT / "config/robots"

# ---------------------------------------------------------------------- reaching laws


@pytest.mark.parametrize("layer", [0.0, 0.2])
@pytest.mark.parametrize("law", LAWS)
def test_reaching_laws_are_what_their_formulas_say(law, layer):
    rho = ReachingLaw(4, law, 3.0, 2.0, 0.5, layer)
    s = np.array([-2.0, 0.5, 0.1, 0.0])
    outside = {
        "constant": 3.0 * np.sign(s),
        "exponential": 3.0 * np.sign(s) + 2.0 * s,
        "power_rate": 3.0 * np.sqrt(np.abs(s)) * np.sign(s),
    }[law]
    at_edge = {"constant": 3.0, "exponential": 3.4, "power_rate": 3.0 * np.sqrt(0.2)}[law]
    expected = np.where(np.abs(s) < layer, at_edge * s / 0.2, outside)
    np.testing.assert_allclose(rho(s), expected, rtol=1e-14)
    np.testing.assert_array_equal(rho(-s), -rho(s))
    extremes = np.array([1e300, -1e300, 5e-324, 1e-300])
    assert np.isfinite(rho(extremes)).all()


@pytest.mark.parametrize("layer", [0.0, 0.2])
@pytest.mark.parametrize("law", LAWS)
def test_the_width_is_where_the_law_balances_the_disturbance(law, layer):
    rho = ReachingLaw(1, law, 3.0, 2.0, 0.5, layer)
    for disturbance in (0.1, 1.0, 2.9, 3.1, 10.0):
        width = rho.width(disturbance, 0.7)
        if np.isfinite(width) and width > 1e-200:
            assert 0.7 * rho(width) == pytest.approx(disturbance)
        elif np.isfinite(width):
            assert disturbance <= 0.7 * rho(np.ones(1))  # the discontinuous law holds s = 0
        else:
            assert law == "constant" and disturbance > 0.7 * 3.0


RELAY = [1.05, 0.9643827661581261, 0.889626895702363, 0.8195517453004846, 0.7468306681052551]
RELAY += [0.6647848324283737, 0.5690184326701698, 0.4584949358394812, 0.33579086098024336]
RELAY += [0.20646495745029042, 0.07769722921039628]  # then 0; Acary & Brogliato 2010


def test_a_layer_of_gain_times_step_is_the_implicit_relay():
    """x' = -sgn x, h = 0.1: exactly 0 from step 10 on; the discontinuous law chatters by h."""
    h, x = 0.1, np.ones(1)
    layered, relay = (ReachingLaw(1, "constant", 1.0, 1.0, 0.5, phi) for phi in (h, 0.0))
    for k in range(1, 16):
        x = x - h * layered(x)
        assert x[0] == pytest.approx(max(1.0 - h * k, 0.0), abs=1e-12)
    assert x[0] == 0.0
    chattering = [y := np.array([1.05])] + [y := y - h * relay(y) for _ in range(40)]
    assert np.abs(chattering[11:]).min() == pytest.approx(0.05, abs=1e-12)


def test_a_layer_of_gain_times_step_is_the_implicit_relay_under_a_disturbance():
    """x' = -sgn x + 0.3 sin 5 t, h = 0.1, with the disturbance of the end of the step."""
    h, x, law = 0.1, np.array([1.05]), ReachingLaw(1, "constant", 1.0, 1.0, 0.5, 0.1)
    for k in range(1, 41):
        moved = x + h * 0.3 * np.sin(5.0 * h * k)
        x = moved - h * law(moved)
        assert x[0] == pytest.approx(RELAY[k] if k < len(RELAY) else 0.0, abs=1e-12)


# ---------------------------------------------------------------------- super-twisting

TWISTING = [  # k1, k2, x1, x2, exact reaching time (Seeber, Horn & Fridman 2018), bound (2012)
    (1.5, 1.1, 1.0, 0.0, 1.7416627251274652, 44.494770318508905),
    (1.5, 1.1, 1.0, 2.0, 2.7964454080757832, 50.746512404743534),
    (2.0, 1.0, 1.0, 0.0, 1.3478329089394705, 69.06666205172417),
    (4.0, 1.0, 0.25, -1.0, 1.218825956180566, 304.4257774706072),
    (3.3541019662496847, 5.5, 1.0, 0.0, 0.7788952494525087, 186.5166869902246),
]


def test_the_bound_is_that_of_moreno_and_osorio():
    k1, k2, x1, x2, exact, bound = np.array(TWISTING).T
    computed = reaching_time_bound(k1, k2, x1, x2)
    np.testing.assert_allclose(computed, bound, rtol=1e-12)
    assert np.all(computed > exact)


@pytest.mark.parametrize(("k1", "k2", "x1", "x2", "exact", "bound"), TWISTING)
def test_super_twisting_takes_the_exact_time(k1, k2, x1, x2, exact, bound):
    """In d theta = dt / |x1|^(1/2) the motion is smooth and ends at infinity; dt sums up."""

    def slope(theta, y):
        root = abs(y[0])  # y = |x1|^(1/2) sgn x1, x2, t
        push, rate = super_twisting(np.array(y[0] * root), k1, k2)
        return 0.5 * (push + y[1]), rate * root, root

    start = np.sqrt(abs(x1)) * np.sign(x1), x2, 0.0
    end = -50.0 / max(np.linalg.eigvals([[-k1 / 2, 0.5], [-k2, 0.0]]).real)
    motion = solve_ivp(slope, (0.0, end), start, "DOP853", rtol=1e-12, atol=1e-14)
    assert motion.y[2, -1] == pytest.approx(exact, abs=1e-8)


def test_super_twisting_in_a_sampled_loop_takes_that_time_up_to_its_step():
    """Explicit steps as in the control loop; |T_h - T| <= 5 h^(1/2) for all five at once."""
    k1, k2, x, w, exact, _ = np.array(TWISTING).T
    h = 1e-4
    outside = np.zeros(5)
    for k in range(1, 40000):
        push, rate = super_twisting(x, k1, k2)
        x, w = x + h * (push + w), w + h * rate
        outside = np.where(np.maximum(np.abs(x), np.abs(w)) > 1e-2, k * h, outside)
    assert np.abs(outside - exact).max() <= 5.0 * np.sqrt(h)


def test_the_bound_withstands_the_worst_disturbance():
    """Random gains and starts under r = +-L, switched for the slowest approach; inf is honest."""
    rng, h, n, L = np.random.default_rng(5), 2e-4, 200, 1.0
    k1, k2 = rng.uniform(2.0, 4.0, n), rng.uniform(1.6, 3.0, n)
    x, w = rng.normal(size=(2, n))
    bound = reaching_time_bound(k1, k2, x, w, L)
    assert np.isfinite(bound).all() and np.all(bound > reaching_time_bound(k1, k2, x, w))
    outside = np.zeros(n)
    for k in range(1, 40000):
        push, rate = super_twisting(x, k1, k2)
        worst = np.where(w != 0.0, np.sign(w), np.sign(x))
        x, w = x + h * (push + w), w + h * (rate + L * worst)
        outside = np.where(np.abs(x) > 1e-3, k * h, outside)
    assert outside.max() < 7.0 and np.all(outside < bound)
    k1, L = np.array([2.0, 2.0]), 1.0
    limit = L + 2.0 * L**2 / k1**2
    time = reaching_time_bound(k1, limit * [0.999, 1.001], 1.0, 0.0, L)
    assert np.isinf(time[0]) and np.isfinite(time[1])
    assert reaching_time_bound(2.0, 2.0, 0.0, 0.0) == 0.0


# ---------------------------------------------------------------------- the prosthetic arm

JOINTS = ("shoulder_flexion", "shoulder_abduction", "wrist_rotation", "wrist_flexion")
LAM = 20.0  # 1/s, of all laws
GAIN = np.array([30.0, 30.0, 200.0, 200.0])  # rad/s^2
START = 0.03  # rad off the reference
LIMITLESS = EffortBox(np.full(4, -np.inf), np.full(4, np.inf))


def reference(t):
    """Within the ranges of the arm."""
    phase = np.array([2.0, 1.5, 2.5, 3.0]) * t + np.array([0.0, 1.0, 0.5, 0.2])
    w, size = np.array([2.0, 1.5, 2.5, 3.0]), np.array([0.3, 0.2, 0.4, 0.3])
    q = np.array([0.5, 0.3, 0.0, 0.0]) + size * np.sin(phase)
    return Reference(q, size * w * np.cos(phase), -size * w**2 * np.sin(phase))


class Disturbance(Load):
    """Matched: 20 % of the largest gravity torque that the reference needs, sinusoidal."""

    def __init__(self, arm):
        still = (arm.response(full(arm, reference(t).q)) for t in np.linspace(0.0, 12.0, 401))
        gravity = np.array([np.linalg.solve(r.mobility, -r.a_free) for r in still])
        self.size = 0.2 * np.abs(gravity).max(axis=0)
        self.index = [joint.v for joint in arm.joints]

    def at(self, t):
        return self.size * np.sin(np.array([4.0, 5.0, 6.0, 5.0]) * t + [0.3, 1.0, 2.0, 0.0])

    def force(self, k, x, u):
        tau = np.zeros(5)
        tau[self.index] = self.at(x.t)
        return tau


def full(arm, z, w=0.0, t=0.0):
    """State of all joints: the elbow follows the shoulder."""
    q, v, robot = np.zeros(5), np.zeros(5), arm.system.robot
    q[[joint.q for joint in arm.joints]] = z
    v[[joint.v for joint in arm.joints]] = w
    elbow, shoulder = robot.joint("elbow"), robot.joint("shoulder_flexion")
    q[elbow.q] = 1.75 * q[shoulder.q] + 0.175
    v[elbow.v] = 1.75 * v[shoulder.v]
    return State(t, q, v)


class Task:
    """The arm as it is, the model that its controllers have, and the disturbance."""

    def __init__(self, scale):
        self.scale, self.scene = scale, arm_scene(1.0)
        self.truth = self.scene.controlled_joints()
        self.model = arm_scene(scale).controlled_joints()
        self.disturbance = Disturbance(self.truth)

    def run(self, controller, duration, dt, start=START):
        """Errors and efforts every dt, commands held between, and the states."""
        ref = reference(0.0)
        simulation = self.scene.simulation(dt=dt, forces=[self.disturbance])
        y = simulation.start(full(self.truth, ref.q + start, ref.v))
        memory, states, controls = controller.begin(), [], []
        for k in range(round(duration / dt)):
            states.append(simulation.system.expand(y))
            controls.append(controller.effort(states[-1], reference(k * dt), memory, LIMITLESS))
            memory = memory + dt * controls[-1].memory_rate
            y = simulation.advance(y, controls[-1].effort, (k + 1) * dt)
        return states, controls

    def errors(self, states, after):
        """Largest |q - q_ref| of each joint."""
        late = [x for x in states if x.t >= after]
        e = [self.truth.positions(x) - reference(x.t).q for x in late]
        return np.abs(e).max(axis=0)

    def mismatch(self, x):
        """What model error and disturbance leave of s' = -rho at a state."""
        r = self.model.response(x)
        keep = sliding_variable(r, reference(x.t), np.full(4, LAM))[1]
        return mismatch(self.truth.response(x), r, keep, self.disturbance.at(x.t))

    def largest(self, layer, dt):
        """Bound of the disturbance of s' for |s| <= layer, commands held for dt.

        At corners of the tube |e| <= layer / lambda, |e'| <= 2 layer around the reference. A
        held command meets the state that it was made for, and the one dt later.
        """
        rng, found = np.random.default_rng(0), []
        for t in np.linspace(0.0, 4.0, 300):
            e, rate = rng.choice([-1.0, 1.0], (2, 4)) * [layer / LAM, 2.0 * layer]
            x, later = (
                full(self.truth, ref.q + e, ref.v + rate, s)
                for s, ref in ((t, reference(t)), (t + dt, reference(t + dt)))
            )
            r, now = self.model.response(x), self.truth.response(later)
            keep = sliding_variable(r, reference(t), np.full(4, LAM))[1]
            due = sliding_variable(now, reference(t + dt), np.full(4, LAM))[1]
            held = mismatch(now, r, keep, self.disturbance.at(t + dt)).disturbance + keep - due
            found += [self.mismatch(x).disturbance, held]
        return np.abs(found).max(axis=0)


def arm_scene(scale):
    """With all masses and inertias scaled."""
    arm = scene_of(
        "integrator: {type: rk4}\n"
        "couplings:\n  elbow: {parent: shoulder_flexion, factor: 1.75, offset: 0.175}\n"
        f"actuators: [{{type: ideal, joints: [{', '.join(JOINTS)}]}}]\n",
        ROBOTS / "prosthetic_arm.urdf",
    )
    return scaled(arm, scale)


@pytest.fixture(scope="module", params=[1.3, 0.7])
def task(request):
    return Task(request.param)


def test_a_mass_error_scales_the_control_and_nothing_else(task):
    """Then joints stay decoupled, and the bound of each stands for itself."""
    np.testing.assert_allclose(
        task.mismatch(full(task.truth, [0.5, 0.3, 0.1, 0.2], 1.0)).effectiveness,
        task.scale * np.eye(4),
        rtol=0,
        atol=1e-12 * 1e3,  # the condition of the mobility
    )


def test_errors_stay_within_the_boundary_layer_bound_and_computed_torque_fails_it(task):
    """1 kHz, layer = 1.3 gain dt for either model; the bound follows from both errors."""
    dt, layer = 1e-3, 1.3e-3 * GAIN
    law = SlidingMode(task.model, bandwidth=LAM, gain=GAIN.tolist(), boundary_layer=layer.tolist())
    largest = task.largest(layer, dt)
    assert np.all(largest < task.scale * GAIN)  # s stays in the layer, where the tube was searched
    bound = law.bound(largest, task.scale)
    states, controls = task.run(law, 4.0, dt)
    sliding = task.errors(states, after=1.0) / bound
    assert np.all(sliding <= 1.0)
    assert np.all(sliding > 0.5)  # the bound is not idle
    assert np.all(np.abs([c.s for c in controls[1000:]]) <= LAM * bound)
    alone = ComputedTorque(task.model, kp=LAM**2, kd=2.0 * LAM)
    states, _ = task.run(alone, 4.0, dt)
    computed = task.errors(states, after=1.0) / bound
    assert np.all(computed > 20.0)


def test_super_twisting_arrives_in_time_stays_and_does_not_chatter(task):
    """10 kHz; the premise, a bound of the disturbance rate, is checked along the motion."""
    dt = 1e-4
    limit = np.array([400.0, 400.0, 1000.0, 1000.0])
    law = SuperTwisting(task.model, bandwidth=LAM, disturbance_rate=limit.tolist())
    states, controls = task.run(law, 0.5, dt)
    d = np.array([task.mismatch(x).disturbance for x in states[::5]])
    assert np.all(np.abs(np.diff(d, axis=0)).max(axis=0) / (5.0 * dt) <= limit)
    bound = law.reaching_time(controls[0].s, d[0], task.scale)
    outside = np.flatnonzero((np.abs([c.s for c in controls]) > 1e-4).any(axis=1))
    arrival = (outside[-1] + 1) * dt
    assert arrival < bound < 30.0
    relay = SlidingMode(task.model, bandwidth=LAM, gain=GAIN.tolist(), boundary_layer=0.0)
    _, switched = task.run(relay, 0.5, dt)
    energies = []
    for answers in (controls, switched):
        meter = ChatterMeter(4, memory=0.1)
        for control in answers[1000:]:
            meter.update(control.effort, dt)
        energies.append(meter.energy)
    assert np.all(energies[1] >= 20.0 * energies[0])
