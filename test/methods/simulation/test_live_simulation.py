"""The simulation that is stepped tick by tick: motion, commands and their loss, divergence."""

import numpy as np
import pytest
from mechanisms import floating_body, scene_of
from places import ROOT

from mbd_ros.core.loads.inputs import Sampled
from mbd_ros.errors import DivergedError, ModelError, SceneError
from mbd_ros.files.body_columns import POSE as POSE_WORDS
from mbd_ros.files.body_columns import TWIST as TWIST_WORDS
from mbd_ros.files.body_columns import names_of
from mbd_ros.methods.inverse_dynamics.inverse_dynamics import InverseDynamics
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch, SafeCommand
from mbd_ros.motion.state_table import table_of

ROBOTS = ROOT / "config/robots"
TICK = 1e-3
POSE, TWIST = names_of("base", POSE_WORDS), names_of("base", TWIST_WORDS)
ARM = f"""robot: {{urdf: {ROBOTS / "prosthetic_arm.urdf"}}}
couplings:
  elbow: {{parent: shoulder_flexion, factor: 1.75, offset: 0.175}}
actuators:
- type: ideal
  joints: [shoulder_flexion, shoulder_abduction, wrist_rotation, wrist_flexion]
"""
STOPS = """constraints:
- {type: joint_stop, joint: shoulder_flexion, upper: 0.05, time_constant: 0.01}
- {type: dry_friction, joint: shoulder_abduction, limit: 0.3, time_constant: 0.01}
"""
PENDULUM = f"""robot: {{urdf: {ROBOTS / "pendulum.urdf"}}}
actuators: [{{type: ideal, joints: [hinge]}}]
initial: {{position: {{hinge: 0.3}}}}
"""


@pytest.fixture
def scene():
    return scene_of


def live(loaded, timeout=0.1, ramp=0.1, tick=TICK):
    watch = CommandWatch(timeout, ramp)
    return LiveSimulation(loaded.simulation, loaded.initial, tick, watch, loaded.safe)


def swinging(t):
    """Commands of the arm [N·m]."""
    return np.array([2.0, 1.0, 0.002, 0.005]) * np.sin(np.array([6.0, 5.0, 7.0, 9.0]) * t + 0.3)


def played(simulation, count, commands=swinging):
    """What `count` ticks under commands show."""
    moments = []
    for k in range(count):
        simulation.watch.take(commands(k * TICK))
        moments.append(simulation.tick())
    return moments


# ---------------------------------------------------------------------- motion


@pytest.mark.parametrize("dt", [1e-3, 2.5e-4])
@pytest.mark.parametrize("more", ["", STOPS, "solver: {type: kkt}\n"])
def test_ticks_are_the_run_with_the_same_commands(scene, more, dt):
    loaded = scene(f"{ARM}{more}dt: {dt}\n")
    held = lambda t: swinging(TICK * np.floor(t / TICK + 1e-6))  # noqa: E731
    simulation = loaded.simulation(sources={loaded.actuators[0].name: Sampled(held, dt)})
    states = list(simulation.run(loaded.initial, 0.3))[:: round(TICK / dt)]
    for moment, x in zip(played(live(loaded), 300), states[1:], strict=True):
        assert moment.t == pytest.approx(x.t, abs=1e-12)
        np.testing.assert_allclose(moment.position, x.q, rtol=0, atol=1e-9)
        np.testing.assert_allclose(moment.velocity, x.v, rtol=0, atol=1e-8)


def test_inverse_dynamics_of_every_tick_gives_the_commanded_torques(scene):
    """Identity over couplings: tau_z of q, v and a is what the actuators were told."""
    loaded = scene(ARM)
    inverse: InverseDynamics = loaded.inverse_dynamics()
    z = loaded.couplings.v_index
    for k, now in enumerate(played(live(loaded), 300)):
        torques = inverse.solve(now.position[z], now.velocity[z], now.acceleration[z])
        np.testing.assert_allclose(torques.tau, swinging(k * TICK), rtol=0, atol=1e-10)
        np.testing.assert_allclose(torques.tau, now.effort[z], rtol=0, atol=1e-10)
        np.testing.assert_allclose(torques.multipliers, now.shown, rtol=0, atol=1e-10)


@pytest.mark.parametrize("more", ["", STOPS, "integrator: {type: adams}\n"])
def test_a_reset_leaves_nothing_behind(scene, more):
    """The same commands give the same bits, also after QP solves and with a multistep method."""
    simulation = live(scene(ARM + more))
    first = played(simulation, 200)
    simulation.tick()
    simulation.reset()
    assert simulation.now.t == 0.0
    for one, two in zip(first, played(simulation, 200), strict=True):
        assert [value.tobytes() for value in one[1:]] == [value.tobytes() for value in two[1:]]


def test_a_tick_that_is_no_whole_number_of_steps_is_refused(scene):
    for dt in ("3e-4", "2e-3"):
        loaded = scene(f"{PENDULUM}dt: {dt}\n")
        with pytest.raises(ModelError, match=r"tick of 0.001 s .* multiple of the step .*rate or"):
            live(loaded)


def test_ticks_of_free_bodies_are_the_offline_table_to_the_bit(scene):
    """Fixed steps; a body that spins keeps the sign of its quaternion over several turns."""
    text = "robot: {base: floating}\ndt: 0.001\nintegrator: {type: rk4}\n"
    loaded = scene(text, floating_body())
    v = np.zeros(loaded.robot.model.nv)
    v[loaded.robot.bases[0].v] = [0.3, -0.2, 0.1, 14.0, 0.5, -1.0]
    initial = loaded.initial._replace(v=v)
    simulation = LiveSimulation(
        loaded.simulation, initial, 5 * TICK, CommandWatch(0.1, 0.1), loaded.safe
    )
    moments = [simulation.now, *(simulation.tick() for _ in range(200))]
    states = list(loaded.simulation().run(initial, 1.0))[::5]
    table, *_ = table_of(loaded.simulation(), states)
    for names, field in ((POSE, "poses"), (TWIST, "twists")):
        offline = np.column_stack([table[name] for name in names])
        assert np.array_equal([getattr(moment, field)[0] for moment in moments], offline)
    quaternions = np.array([moment.poses[0, 3:] for moment in moments])
    assert ((quaternions[1:] * quaternions[:-1]).sum(axis=1) > 0.9).all()
    assert quaternions[:, 3].min() < -0.5


# ---------------------------------------------------------------------- commands and their loss


def test_lost_commands_fade_to_the_safe_one_and_come_back_without_a_bump(scene):
    """Held for the timeout, faded within the ramp; the torque never steps by more than a share."""
    loaded = scene(PENDULUM + "safe: {type: zero}\n")
    simulation = live(loaded, timeout=0.02, ramp=0.05)
    efforts = []
    for k in range(200):
        if k < 10 or k >= 120:
            simulation.watch.take(np.array([2.0]))
        efforts.append(float(simulation.tick().effort[0]))
    assert efforts[:29] == [2.0] * 29  # the last command at 9 ms, held until 29 ms
    assert efforts[80:120] == [0.0] * 40
    np.testing.assert_allclose(efforts[29:79], 2.0 - 0.04 * np.arange(1, 51), atol=1e-12)
    np.testing.assert_allclose(efforts[120:170], 0.04 * np.arange(1, 51), atol=1e-12)
    assert efforts[170:] == [2.0] * 30


def test_without_any_command_the_safe_one_acts_and_a_first_one_in_time_acts_at_once(scene):
    simulation = live(scene(PENDULUM + "safe: {type: damping, gain: 0.5}\n"), timeout=0.1)
    for _ in range(50):
        before = simulation.now.velocity
        effort = simulation.tick().effort
        np.testing.assert_allclose(effort, -0.5 * before, rtol=0.05, atol=1e-12)
    assert simulation.watch.is_safe
    simulation.watch.take(np.array([1.5]))
    assert simulation.tick().effort == [1.5]
    assert not simulation.watch.is_safe


def test_commands_are_counted(scene):
    watch = (simulation := live(scene(PENDULUM))).watch
    for _ in range(3):
        watch.take(np.zeros(1))
    simulation.tick()
    watch.take(np.zeros(1))
    simulation.tick()
    simulation.tick()
    assert (watch.received, watch.superseded) == (4, 2)
    assert watch.age == pytest.approx(2e-3)


@pytest.mark.parametrize("gain", [1e-3, 1.0, 1e6])
def test_damping_brakes_at_any_gain(scene, gain):
    """A held torque of -gain v would diverge at the wrist, of 1e-3 kg·m^2, beyond gain 2."""
    more = "initial: {velocity: {wrist_rotation: 4.0, shoulder_flexion: 1.0}}\n"
    simulation = live(scene(f"{ARM}safe: {{gain: {gain}}}\n{more}"), timeout=1e-3, ramp=0.0)
    before = np.abs(simulation.now.velocity).max()
    for _ in range(300):
        now = simulation.tick()
        assert np.abs(now.velocity).max() <= 1.5 * before
    if gain == 1e6:
        assert np.abs(now.velocity).max() < 1e-2


def test_the_damper_is_the_implicit_one():
    """Closed form: m v' = -c v over a step, implicit, ends at v / (1 + h c / m)."""
    m, c, h, v = 2.0, 30.0, 0.1, np.array([1.5])
    tau = SafeCommand("damping", c).torque(v, np.array([[1.0 / m]]), h)
    assert v + h * tau / m == pytest.approx(v / (1.0 + h * c / m))
    assert SafeCommand("damping", c).torque(v, np.array([[1.0 / m]]), 1e-9) == pytest.approx(
        -c * v
    )
    assert SafeCommand("zero").torque(v, np.array([[1.0 / m]]), h) == [0.0]


def test_safe_commands_speak_the_language_of_the_actuator(scene):
    """A command of a torque gives it: motor torque behind a gear, position behind a spring."""
    loaded = scene(
        f"robot: {{urdf: {ROBOTS / 'prosthetic_arm.urdf'}}}\nactuators:\n"
        "- {type: geared_motor, joint: elbow, ratio: -40.0}\n"
        "- {type: series_elastic, joint: shoulder_flexion, stiffness: 80.0, damping: 1.0}\n"
        "- {type: ideal, joints: [wrist_rotation]}\n"
        "initial: {position: {shoulder_flexion: 0.4}, velocity: {shoulder_flexion: 0.7}}\n"
    )
    system = loaded.system()
    loads = system.loads
    wanted = np.array([0.3, -2.0, 0.01])
    u = loads.command(wanted, loaded.initial)
    tau = loads.actuator_torque(system.k, loaded.initial, u)
    joints = [loaded.robot.joint(name).v for name in loads.commands]
    np.testing.assert_allclose(tau[joints], wanted, rtol=1e-12)


@pytest.mark.parametrize(
    ("entry", "reason"),
    [
        ("{type: hold}", "safe: unknown type 'hold', accepted: damping, zero"),
        ("{gain: -1}", "safe: gain -1 must be finite and >= 0"),
        ("{gian: 1}", "safe: unknown key 'gian', accepted: type, gain"),
    ],
)
def test_a_bad_safe_section_is_refused(scene, entry, reason):
    with pytest.raises(SceneError, match=reason):
        scene(f"{PENDULUM}safe: {entry}\n")


# ---------------------------------------------------------------------- divergence


def test_divergence_keeps_the_last_finite_state_until_a_reset(scene):
    """Fault 32."""
    simulation = live(scene(PENDULUM + "integrator: {type: rk4}\n"))
    good = played(simulation, 5, lambda t: np.array([0.1]))[-1]
    simulation.watch.take(np.array([1e308]))
    seen = [good]
    with pytest.raises(DivergedError, match=r"t = .*hinge"):
        seen.extend(simulation.tick() for _ in range(100))
    good = seen[-1]
    assert simulation.now is good
    assert all(np.isfinite(value).all() for value in simulation.now[1:])
    for _ in range(2):
        with pytest.raises(DivergedError, match=r"hinge.*; reset it first"):
            simulation.tick()
    assert simulation.now is good
    simulation.reset()
    assert played(simulation, 5, lambda t: np.array([0.1]))[-1].t == pytest.approx(5 * TICK)
