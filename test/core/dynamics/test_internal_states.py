"""Internal states of parts: against equations written by hand, in every method and every tier."""

import math

import numpy as np
import pinocchio as pin
import pytest
from internal_states import DRIVE, INERTIA, WEIGHT, driven, numbers, pendulum, rates_by_hand
from places import ROOT
from scipy.integrate import simpson, solve_ivp
from symbolic_numbers import Symbols

from mbd_ros.api import scene_from
from mbd_ros.core.contracts import Actuator, Channel, Internal, Load, Part
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.loads.inputs import HeldTable
from mbd_ros.core.loads.internal_states import Internals
from mbd_ros.core.rows.constraint import box
from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError, ModelError, SceneError, SolveError
from mbd_ros.features.simulation.job import simulate
from mbd_ros.files.table import Result, Table
from mbd_ros.methods.integration.runge_kutta import RungeKutta
from mbd_ros.methods.simulation.live_simulation import LiveSimulation
from mbd_ros.methods.simulation.safe_command import CommandWatch
from mbd_ros.methods.simulation.simulation import Simulation
from mbd_ros.methods.simulation.stall import WINDOW, StallWatch
from mbd_ros.parts.actuators.series_elastic_drive import SeriesElasticDrive
from mbd_ros.parts.constraints.dry_friction import DryFriction
from mbd_ros.parts.integrators.adams import Adams
from mbd_ros.parts.integrators.rk4 import Rk4
from mbd_ros.parts.stabilization.none import NoStabilization

NOT_ITS_OWN = ("type", "name")
METHODS = {  # dt of the tests of order
    "adams": 2e-3,
    "dop853": 2.5e-2,
    "dopri5": 2.5e-3,
    "filippov": 2.5e-2,
    "gauss_legendre": 1e-2,
    "generalized_alpha": 1e-3,
    "moreau_jean": 1e-3,
    "rattle": 1e-3,
    "rk4": 5e-3,
    "semi_implicit_euler": 1e-4,
    "shake": 1e-3,
}


def ended(scene, duration, u=0.0, **options):
    return list(driven(scene, u, **options).run(scene.initial, duration))[-1]


def by_hand(duration, u):
    """The end of the motion of `pendulum()`, and the work done and lost."""
    start = [0.7, 0.0, 3.0, 8.0, 0.0, 0.0]
    found = solve_ivp(
        lambda t, y: rates_by_hand(y, u),
        *((0.0, duration), start, "DOP853"),
        **{"rtol": 1e-13, "atol": 1e-13},
    )
    return found.y[:, -1]


@pytest.mark.parametrize("u", [0.6, 30.0])  # the second one beyond the limit
@pytest.mark.parametrize(
    ("method", "dt"),
    [
        ({"type": "dopri5", "tolerance": 1e-12}, 1e-2),
        ({"type": "dop853", "tolerance": 1e-12}, 1e-2),
        ({"type": "dop853"}, 5e-3),
        ({"type": "rk4"}, 1e-4),
        ({"type": "gauss_legendre", "stages": 3}, 2e-3),
        ({"type": "adams", "order": 6}, 5e-4),
    ],
)
def test_the_drive_moves_as_equations_by_hand_say(method, dt, u):
    found = numbers(ended(pendulum(integrator=method, dt=dt), 0.5, u))
    assert np.abs(found - by_hand(0.5, u)[:4]).max() < 1e-9


def test_rotor_and_joint_swing_about_what_they_keep():
    """Without gravity, friction and torque: two inertias at one spring, in closed form."""
    drive = {key: DRIVE[key] for key in ("type", "joint", "name", "stiffness", "ratio")}
    drive["rotor_inertia"] = 2e-3
    scene = pendulum(
        **{"robot": {"gravity": [0.0, 0.0, 0.0]}, "actuators": [drive]},
        integrator={"type": "dop853", "tolerance": 1e-12},
    )
    x, t, n, k = ended(scene, 1.0), 1.0, 5.0, 40.0
    rotor = 2e-3 * n**2  # at the joint
    q, v, theta, omega = 0.7, 0.0, 3.0 / n, 8.0 / n
    drift = (rotor * omega + INERTIA * v) / (rotor + INERTIA)
    middle = (rotor * theta + INERTIA * q) / (rotor + INERTIA) + drift * t
    w = math.sqrt(k / rotor + k / INERTIA)
    stretch = (theta - q) * math.cos(w * t) + (omega - v) / w * math.sin(w * t)
    rate = (omega - v) * math.cos(w * t) - w * (theta - q) * math.sin(w * t)
    share = INERTIA / (rotor + INERTIA)
    expected = [
        *(middle - (1.0 - share) * stretch, drift - (1.0 - share) * rate),
        *(n * (middle + share * stretch), n * (drift + share * rate)),
    ]
    assert numbers(x) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_keeps_its_order(method):
    end = 0.1 if METHODS[method] < 1e-2 else 1.0
    exact, errors = by_hand(end, 0.6)[:4], []
    for dt in (METHODS[method], METHODS[method] / 2.0):
        scene = pendulum(integrator={"type": method}, dt=dt)
        errors.append(np.abs(numbers(ended(scene, end, 0.6)) - exact).max())
    order = scene.integrator.order
    assert math.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.25)


def test_energy_changes_by_the_work_of_the_motor_less_what_is_lost():
    scene = pendulum(integrator={"type": "dop853"}, dt=1e-4)
    samples = list(driven(scene, 0.6).run(scene.initial, 0.3))
    system = driven(scene, 0.6).system
    energy = [system.energy(x) for x in samples]
    shown = [rates_by_hand(numbers(x), 0.6)[4:] for x in samples]
    drive, u = scene.actuators[0], np.array([0.6])
    for x, expected in zip(samples[::500], shown[::500], strict=True):
        assert drive.show(system.k, x, u, None)[1:] == pytest.approx(expected, rel=1e-12)
    power, loss = np.array(shown).T
    work = simpson(power - loss, dx=1e-4)
    scale = max(energy) - min(energy)
    assert energy[-1] - energy[0] == pytest.approx(work, abs=1e-9 * max(scale, 1.0))
    done, lost = by_hand(0.3, 0.6)[4:]
    assert energy[-1] - energy[0] == pytest.approx(done - lost, abs=1e-9)
    assert lost > 0.1 and abs(done) > 0.1


def test_at_its_largest_speed_the_motor_gives_what_keeps_it_there():
    first = {"position": {"hinge": 0.7}, "internal": {"drive": {"angle": 3.5, "speed": 8.0}}}
    scene = pendulum(
        actuators=[{**DRIVE, "speed": 9.0}], initial=first, integrator={"type": "rk4"}, dt=1e-4
    )
    samples = list(driven(scene, 1.8).run(scene.initial, 0.05))
    at_limit = [x for x in samples if x.z[1] == 9.0]
    assert len(at_limit) > 100 and at_limit == samples[-len(at_limit) :]
    system, drive, u = driven(scene, 1.8).system, scene.actuators[0], np.array([1.8])
    power, loss = np.array([drive.show(system.k, x, u, None)[1:] for x in at_limit]).T
    work = simpson(power - loss, dx=1e-4)
    gained = system.energy(at_limit[-1]) - system.energy(at_limit[0])
    assert gained == pytest.approx(work, rel=1e-9)
    assert power.max() < 0.9 * 1.8 * 9.0


LEG = {
    "actuators": [
        {**DRIVE, "joint": "ankle", "name": "drive"},
        {**DRIVE, "joint": "knee", "name": "other", "stiffness": 70.0},
    ],
    "initial": {
        "position": {"ankle": 0.2, "hip_flexion": -0.3},
        "velocity": {"hip_flexion": 1.1},
        "internal": {
            **{"drive": {"angle": 0.3, "speed": -1.0}},
            **{"other.angle": 0.1, "other.speed": 2.0},
        },
    },
    "integrator": {"type": "dop853", "tolerance": 1e-12},
}
BAR = {"type": "distance", "frame_a": "world", "frame_b": "foot", "point_a": [0.5, 0.3, 0.4]}
BAR["distance"] = 1.0
ROBOTS = ROOT / "config/robots"
HEAVY_BASE = (
    '<link name="world"/>',
    '<link name="world"><inertial><origin xyz="0 0 0.1"/><mass value="9"/>'
    '<inertia ixx="0.2" iyy="0.3" izz="0.25" ixy="0" ixz="0.01" iyz="0"/></inertial></link>',
)
OTHERS = {
    "open": {},
    "coupled": {"couplings": {"knee": {"parent": "hip_flexion", "factor": 0.7}}},
    "coupled, kept by rows": {
        "couplings": {"knee": {"parent": "hip_flexion", "factor": 0.7}},
        "solver": {"type": "kkt"},
    },
    "floating": {"robot": {"base": "floating"}},
    "floating, by collocation": {
        "robot": {"base": "floating"},
        "integrator": {"type": "gauss_legendre", "stages": 3},
        "dt": 1e-3,
    },
}


def leg_by_hand(scene, duration):
    """Pinocchio's masses and forces, the rest by hand; couplings as rows J v = 0."""
    model = scene.robot.model
    data, nv, nq = model.createData(), model.nv, model.nq
    drives = [(scene.robot.joint(one["joint"]), one) for one in LEG["actuators"]]
    J = np.zeros((1, nv))
    if scene.couplings.dependent:
        knee, hip = scene.robot.joint("knee").v, scene.robot.joint("hip_flexion").v
        J[0, knee], J[0, hip] = 1.0, -0.7

    def rates(t, y):
        q, v, z = y[:nq], y[nq : nq + nv], y[nq + nv :]
        tau, zdot = np.zeros(nv), []
        for i, (joint, one) in enumerate(drives):
            now = [q[joint.q], v[joint.v], *z[2 * i : 2 * i + 2]]
            rate = now[3] / 5.0 - now[1]
            tau[joint.v] = one["stiffness"] * (now[2] / 5.0 - now[0]) + 0.3 * rate
            zdot += rates_by_hand(now, 0.0, one)[2:4]
        free = tau - pin.nonLinearEffects(model, data, q, v)
        M = pin.crba(model, data, q)
        if J.any():
            whole = np.block([[M, -J.T], [J, np.zeros((1, 1))]])
            a = np.linalg.solve(whole, np.append(free, 0.0))[:nv]
        else:
            a = np.linalg.solve(M, free)
        return np.concatenate((configuration_rate(q, v), a, zdot))

    def configuration_rate(q, v):
        if nq == nv:
            return v
        turn = pin.Quaternion(q[3:7])
        spin = turn * pin.Quaternion(0.0, *v[3:6])
        return np.concatenate((turn.matrix() @ v[:3], 0.5 * spin.coeffs(), v[6:]))

    x = scene.initial
    start = np.concatenate((x.q, x.v, x.z))
    found = solve_ivp(rates, (0.0, duration), start, "DOP853", rtol=1e-12, atol=1e-12)
    return found.y[:, -1]


@pytest.mark.parametrize("sections", OTHERS.values(), ids=OTHERS)
def test_every_tier_carries_them(sections):
    text = (ROBOTS / "prosthetic_leg.urdf").read_text(encoding="utf-8")
    scene = scene_from({**LEG, **sections}, urdf=text.replace(*HEAVY_BASE))
    found = numbers(ended(scene, 0.05))
    assert np.abs(found - leg_by_hand(scene, 0.05)).max() < 1e-9


def test_a_loop_and_stops_go_with_them_and_energy_says_so():
    """A bar to the world, no losses: the energy of the whole stays."""
    drive = {**DRIVE, "joint": "ankle", "damping": 0.0, "viscous": 0.0}
    stop = {"type": "joint_stop", "joint": "knee", "lower": -3.0, "upper": 3.0}
    stop["time_constant"] = 0.01
    first = {"internal": {"drive": {"angle": 1.0, "speed": 9.0}}}
    for constraints in ([BAR], [BAR, stop]):
        scene = scene_from(
            {
                **{"actuators": [drive], "constraints": constraints, "initial": first},
                **{"integrator": {"type": "dop853"}, "dt": 1e-3},
            },
            urdf="prosthetic_leg",
        )
        simulation = scene.simulation()
        states = list(simulation.run(scene.initial, 0.1))
        system = simulation.system
        energy = [system.energy(system.reduce(x)) for x in states]
        assert np.ptp(energy) < 1e-9 * max(1.0, np.abs(energy).max())
        assert abs(states[-1].z[0] - 1.0) > 0.1


@pytest.mark.parametrize(
    "method",
    [*({"type": name} for name in METHODS), {"type": "dopri5", "tolerance": 1e-6}],
    ids=lambda method: "_".join(map(str, method.values())),
)
def test_checkpoints_keep_the_bits(method):
    scene = pendulum(integrator=method, dt=1e-3)
    whole = driven(scene, 0.6)
    expected = list(whole.run(scene.initial, 0.03))
    first, second = driven(scene, 0.6), driven(scene, 0.6)
    run = first.run(scene.initial, 0.03)
    head = [next(run) for _ in range(14)]
    rest = list(second.run(first.checkpoint(), 0.03))
    for x, y in zip([*head, *rest], expected, strict=True):
        assert numbers(x).tobytes() == numbers(y).tobytes()


def test_a_checkpoint_of_a_scene_without_them_is_refused():
    scene = pendulum()
    simulation, other = scene.simulation(), pendulum(actuators=None, initial=None).simulation()
    simulation.start(scene.initial)
    with pytest.raises(ModelError, match="1 velocities and 2 internal states cannot be"):
        other.resume(simulation.checkpoint())


class Muscle(Actuator):
    """Activation between 0 and 1 that follows its excitation; refuses to be asked elsewhere."""

    inputs = (Channel("", "-", -9.0, 9.0),)
    internal = (Internal("activation", "", 0.0, 1.0),)

    def __init__(self, robot, *, joint="hinge", rate=50.0, torque=3.0):
        self.joint, self.joints, self.nv = robot.joint(joint), (joint,), robot.model.nv
        self.rate, self.torque, self.asked = rate, torque, []

    def force(self, k, x, u):
        tau = np.zeros(self.nv)
        tau[self.joint.v] = self.torque * self.inside(x)
        return tau

    def rates(self, k, x, u):
        return self.rate * (u[self.u] - self.inside(x))

    def inside(self, x):
        activation = x.z[self.z].item()
        self.asked.append(activation)
        assert 0.0 <= activation <= 1.0
        return activation


def with_part(kind, *, integrator, dt=1e-3, initial=None, **arguments):
    """The pendulum with a part of a class of this file."""
    scene = scene_from(
        {"integrator": integrator, "dt": dt, "initial": initial or {"position": {"hinge": 0.7}}},
        urdf="pendulum",
    )
    part = kind(scene.robot, **arguments)
    part.name = kind.__name__.lower()
    section = "actuators" if isinstance(part, Actuator) else "forces"
    return scene.holding(**{section: (part,)})


@pytest.mark.parametrize("method", METHODS)
def test_nothing_is_asked_beyond_the_bounds(method):
    """Excitations of 5 and of -5 press an activation against both ends."""
    scene = with_part(Muscle, integrator={"type": method}, dt=2e-3)
    (muscle,) = scene.actuators
    held = HeldTable(np.array([0.0, 0.1]), np.array([[5.0], [-5.0]]))
    states = list(scene.simulation(sources={muscle.name: held}).run(scene.initial, 0.2))
    z = np.array([x.z[0] for x in states])
    assert (z >= 0.0).all() and (z <= 1.0).all() and muscle.asked
    assert z[50] == 1.0 and z[-1] == 0.0
    assert np.isfinite([x.v[0] for x in states]).all()


def test_dense_output_stays_inside_the_bounds():
    scene = with_part(Muscle, integrator={"type": "dopri5", "tolerance": 1e-3}, dt=1e-3)
    held = HeldTable(np.array([0.0]), np.array([[5.0]]))
    simulation = scene.simulation(sources={"muscle": held})
    z = np.array([x.z[0] for x in simulation.run(scene.initial, 0.2)])
    assert simulation.steps < 100 and ((z >= 0.0) & (z <= 1.0)).all()


class Lag(Load):
    """A state that follows time and moves nothing: z' = rate (sin t - z)."""

    internal = (Internal("", "m", -0.01, 0.01, 0.0),)

    def __init__(self, robot, *, rate=30.0, size=1.0):
        self.nv, self.rate, self.size = robot.model.nv, rate, size

    def force(self, k, x, u):
        return np.zeros(self.nv)

    def rates(self, k, x, u):
        return self.rate * (self.size * math.sin(x.t) - x.z[self.z])


@pytest.mark.parametrize("tolerance", [1e-5, 1e-8])
def test_error_control_sees_a_state_that_moves_nothing(tolerance):
    """In closed form; the scale of its errors is the distance of its bounds."""
    size, r, t = 5e-3, 30.0, 1.5
    scene = with_part(
        Lag, integrator={"type": "dopri5", "tolerance": tolerance}, dt=0.5, rate=r, size=size
    )
    simulation = scene.simulation()
    x = list(simulation.run(scene.initial, t))[-1]
    expected = r * (r * math.sin(t) - math.cos(t) + math.exp(-r * t)) / (r * r + 1.0) * size
    error = abs(x.z[0] - expected) / 0.02
    assert error < 20.0 * tolerance and simulation.steps > 10


def test_an_internal_state_without_a_name_goes_by_its_part():
    scene = with_part(Lag, integrator={"type": "rk4"})
    assert scene.internals.names == scene.system().internals.names == ("lag",)
    x = list(scene.simulation().run(scene.initial, 0.01))[-1]
    assert x.z[0] > 0.0


def test_scenes_without_them_take_the_steps_they_took():
    scene = pendulum(actuators=None, initial=None)
    for method, kind in ((Rk4(), RungeKutta), (Adams(), type(Adams().prepare(scene.system(), 1)))):
        simulation = scene.simulation(integrator={"type": type(method).__name__.lower()})
        assert type(simulation.stepper) is kind


def test_derivatives_are_those_of_the_equations():
    scene = pendulum()
    system, x = scene.system(), scene.initial
    of, n, h = system.derivatives(x, np.array([0.6])), 5.0, 1e-6
    y = numbers(x)
    slopes = np.empty((4, 4))
    for i, unit in enumerate(np.eye(4)):
        ends = [np.array(rates_by_hand(y + s * h * unit, 0.6)[:4]) for s in (1.0, -1.0)]
        slopes[:, i] = (ends[0] - ends[1]) / (2.0 * h)
    found = np.block([[of.q, of.v, of.z], [of.rates.q, of.rates.v, of.rates.z]])
    np.testing.assert_allclose(found, slopes[[1, 2, 3]], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(of.u, [[0.0]], atol=1e-6)
    np.testing.assert_allclose(of.rates.u, [[0.0], [1.0 / 2e-3]], rtol=1e-6, atol=1e-6)
    assert n == scene.entries["actuators"][0]["ratio"]


def test_the_fastest_rate_is_that_of_rotor_and_joint():
    """No gravity: eigenvalues of two inertias at one damped spring, in closed form."""
    from mbd_ros.methods.integration.linear_motion import fastest_rate

    drive = {**DRIVE, "viscous": 0.0, "damping": 0.0}
    scene = pendulum(robot={"gravity": [0.0, 0.0, 0.0]}, actuators=[drive])
    w = math.sqrt(40.0 / (2e-3 * 25.0) + 40.0 / INERTIA)
    assert fastest_rate(scene.system(), scene.initial) == pytest.approx(w, rel=1e-5)
    text = scene.with_(dt=1.0).check()
    assert "stiff: fastest rate 30.3 1/s" in text


def test_a_state_that_nobody_gives_starts_at_its_equilibrium():
    """The motor holds its torque by the spring: u = tau / ratio, at rest."""
    scene = pendulum(initial={"position": {"hinge": 0.7}, "velocity": {"hinge": 0.4}})
    simulation = driven(scene, 0.6)
    x = next(simulation.run(scene.initial, 1.0))
    torque = 0.6 * 5.0 + 0.3 * 0.4  # damper included, whose motor side stands
    assert x.z == pytest.approx([5.0 * (0.7 + torque / 40.0), 0.0], abs=1e-9)
    assert np.abs(simulation.system.rates(x, np.array([0.6]))).max() < 1e-6


@pytest.mark.parametrize("given", [{"angle": 9.0}, {"speed": 8.0}])
def test_a_drive_starts_at_what_is_given_and_else_without_torque_on_its_rotor(given):
    """An angle alone: the motor stands, however far its spring is from rest. A speed alone: the
    angle at which the spring and the friction of the motor hold the rotor at that speed."""
    first = {"position": {"hinge": 0.7}, "internal": {"drive": given}}
    scene = pendulum(initial=first)
    friction, damper = -5.0 * 1e-3 * 8.0, 0.3 * 8.0 / 5.0  # on the side of the joint
    at_speed = 5.0 * (0.7 + (friction - damper) / 40.0)
    expected = [given.get("angle", at_speed), given.get("speed", 0.0)]
    assert scene.simulation().start(scene.initial).z == pytest.approx(expected, abs=1e-9)


class Bristle(Load):
    """An equilibrium that is not linear: z' = 2 - exp(z) - z^3, at 0.3866 and nowhere else."""

    internal = (Internal("bend", "m", -1.0, 5.0),)
    shift = 2.0

    def __init__(self, robot):
        self.nv = robot.model.nv

    def force(self, k, x, u):
        return np.zeros(self.nv)

    def rates(self, k, x, u):
        z = x.z[self.z]
        return self.shift - np.exp(z) - z**3


class Winding(Bristle):
    """No equilibrium: it is wound up for ever."""

    internal = (Internal("bend", "m"),)

    def rates(self, k, x, u):
        return 1.0 + x.z[self.z] ** 2


class Pressed(Winding):
    """It is wound up to an end, where it rests."""

    internal = (Internal("bend", "m", -1.0, 1.0),)


def test_equilibria_are_found_at_ends_too_and_else_refused_by_name():
    rk4 = {"type": "rk4"}
    scene = with_part(Bristle, integrator=rk4)
    (z,) = scene.simulation().start(scene.initial).z
    assert 2.0 - math.exp(z) - z**3 == pytest.approx(0.0, abs=1e-12)
    scene = with_part(Pressed, integrator=rk4)
    assert scene.simulation().start(scene.initial).z.tolist() == [1.0]
    scene = with_part(Winding, integrator=rk4)
    with pytest.raises(SolveError, match=r"no equilibrium of winding.bend at t = 0 s"):
        scene.simulation().start(scene.initial)


def test_a_drive_without_damping_starts_at_a_given_angle_too():
    """No speed stops what the spring pulls at, and none is asked for."""
    free = {**DRIVE, "damping": 0.0, "viscous": 0.0}
    given = {"position": {"hinge": 0.3}, "internal": {"drive": {"angle": 0.2}}}
    scene = pendulum(initial=given, actuators=[free])
    assert scene.simulation().start(scene.initial).z.tolist() == [0.2, 0.0]


@pytest.mark.parametrize(
    ("internal", "message"),
    [
        ({"drive.angel": 1.0}, "internal: unknown 'drive.angel', accepted: drive.angle, drive.sp"),
        ({"drive": {"angle": "x"}}, r"internal.drive.angle: expected a number, got 'x'"),
        ({"drive": {"speed": -11.0}}, r"internal: drive.speed -11 starts outside .*, -10 .. 10"),
    ],
)
def test_first_values_are_refused_by_name(internal, message):
    with pytest.raises(SceneError, match=message):
        pendulum(initial={"internal": internal}, actuators=[{**DRIVE, "speed": 10.0}])


def test_first_values_of_a_scene_without_states_are_refused():
    with pytest.raises(SceneError, match="accepted: none, no part has internal states"):
        pendulum(actuators=None)


def test_other_numbers_and_other_parts_keep_each_value_at_its_state():
    scene = pendulum()
    assert scene.with_({"initial.internal.drive.angle": 0.25}).initial.z.tolist() == [0.25, 8.0]
    assert scene.with_({"drive.stiffness": 50.0}).initial.z.tolist() == [3.0, 8.0]
    other = {**DRIVE, "name": "aid", "limit": 1.0}
    more = scene.with_(actuators=[other, DRIVE])
    assert more.internals.names[2:] == ("drive.angle", "drive.speed")
    np.testing.assert_equal(more.initial.z, [math.nan, math.nan, 3.0, 8.0])


def test_a_table_holds_them_and_a_run_goes_on_from_it():
    scene = pendulum(integrator={"type": "rk4"}, dt=1e-3)
    result = simulate(scene, 0.2)
    table = result["samples"]
    units = {column.name: column.unit for column in table.columns}
    assert units["drive.angle"] == "rad" and units["drive.speed"] == "rad/s"
    later = simulate(scene, 0.1, origin=result, start=0.1)["samples"]
    for name in ("drive.angle", "drive.speed", "hinge.position", "drive.torque", "energy"):
        np.testing.assert_allclose(later[name], table[name][100:], rtol=1e-13, atol=1e-13)
    kept = [column for column in table.columns if column.name != "drive.speed"]
    said = []
    without = Result({"samples": Table(kept)})
    fresh = simulate(scene, 0.1, origin=without, start=0.1, say=said.append)["samples"]
    assert said[0] == "the result: no column drive.speed: they start as in the scene"
    assert fresh["drive.angle"][0] == table["drive.angle"][100]
    assert fresh["drive.speed"][0] == 8.0


def test_check_says_where_each_state_starts():
    lines = pendulum(initial=None, actuators=[{**DRIVE, "speed": 10.0}]).check().splitlines()
    assert "state       drive.angle [rad], starts at equilibrium" in lines
    assert "state       drive.speed [rad/s], starts at 0, in -10 .. 10" in lines


def test_check_of_a_scene_with_loops_takes_first_values():
    first = {"internal": {"drive": {"angle": 1.0}, "drive.speed": 9.0}}
    drive = {**DRIVE, "joint": "ankle"}
    leg = {"urdf": str(ROBOTS / "prosthetic_leg.urdf")}
    said = scene_from(
        {"robot": leg, "constraints": [BAR], "initial": first, "actuators": [drive]}
    ).check()
    assert "drive.angle [rad], starts at 1\n" in said
    assert "one inverse-dynamics call" in said


class Runaway(Lag):
    """z' = z^2: without bound after 0.1 s."""

    internal = (Internal("charge", "C", initial=10.0),)

    def rates(self, k, x, u):
        return x.z[self.z] ** 2


@pytest.mark.filterwarnings("ignore:overflow")
@pytest.mark.filterwarnings("ignore:invalid")
@pytest.mark.parametrize("method", ["rk4", "semi_implicit_euler", "adams"])
def test_a_state_beyond_all_numbers_is_named(method):
    scene = with_part(Runaway, integrator={"type": method})
    with pytest.raises(
        DivergedError, match=r"diverged at t = 0.1\d* s: runaway.charge overflowed"
    ):
        list(scene.simulation().run(scene.initial, 1.0))


def test_parts_that_a_motion_does_not_show_are_refused_in_the_inverse():
    scene = with_part(Bristle, integrator={"type": "rk4"})
    with pytest.raises(SceneError, match="inverse dynamics cannot know the internal states"):
        scene.inverse_dynamics()
    with pytest.raises(SceneError, match="a controller cannot know the internal states"):
        scene.controlled_joints()
    assert pendulum().inverse_dynamics().solve(*np.ones((3, 1)), []) is not None


def test_a_state_of_another_scene_is_refused_by_number():
    with pytest.raises(
        ModelError, match=r"has 0 internal states, but the scene has 2: drive.angle"
    ):
        pendulum().system().evaluate(State(0.0, np.zeros(1), np.zeros(1)))


def test_parts_nobody_has_bound_do_not_share_a_state():
    robot = pendulum().robot
    drives = [
        SeriesElasticDrive(robot, joint="hinge", stiffness=1.0, rotor_inertia=1.0)
        for _ in range(2)
    ]
    assert Internals(drives[:1]).nz == 2
    with pytest.raises(ModelError, match="share an internal state; bind their slots"):
        Internals(drives)


class Refusing(Rk4):
    """A method that moves no internal states."""

    keeps_internal = False


def test_a_method_that_cannot_move_them_is_refused_by_name():
    system, stabilization = pendulum().system(), NoStabilization()
    with pytest.raises(
        ModelError,
        match=r"integrator refusing cannot integrate the internal .* drive.angle, drive",
    ):
        Simulation(system, Refusing(), stabilization, 1e-3)
    Simulation(pendulum(actuators=None, initial=None).system(), Refusing(), stabilization, 1e-3)


def test_sliding_friction_beside_a_drive():
    """Filippov's solution: the rod sticks while spring and weight are below 3 N·m, by hand."""
    friction = {"type": "switching_force", "velocity": {"hinge": [0.0, 1.0]}}
    friction |= {"above": {"hinge": -3.0}, "below": {"hinge": 3.0}}
    scene = pendulum(forces=[friction], integrator={"type": "filippov", "tolerance": 1e-12})
    states = list(driven(scene, 0.6).run(scene.initial, 0.4))

    def pull(y):
        return rates_by_hand(y, 0.6)[1] * INERTIA

    y, t, ways = np.array([0.7, 0.0, 3.0, 8.0]), 0.0, [0.0]
    while t < 0.4:
        is_free = abs(pull(y)) > 3.0 or (len(ways) > 1 and not ways[-1])  # a rod that stuck
        way = math.copysign(1.0, pull(y)) if is_free else 0.0
        ways.append(way)

        def rates(_, y, way=way):
            v, a, omega, speed, *_ = rates_by_hand(y, 0.6)
            return [v, a - 3.0 * way / INERTIA, omega, speed] if way else [0.0, 0.0, omega, speed]

        def leaves(_, y, way=way):
            return y[1] if way else 3.0 - abs(pull(y))

        leaves.terminal, leaves.direction = True, -way if way else -1.0
        options = {"rtol": 1e-13, "atol": 1e-13, "events": leaves}
        found = solve_ivp(rates, (t, 0.4), y, "DOP853", **options)
        t, y = found.t[-1], found.y[:, -1]
        y[1] = 0.0 if found.status else y[1]
    assert 0.0 in ways[1:] and len(set(ways[1:])) > 1 and len(ways) < 40
    assert np.abs(numbers(states[-1]) - y).max() < 1e-9


class Worn(DryFriction):
    """Friction whose largest force is an internal state: limit' = -3 limit."""

    internal = (Internal("limit", "N·m", 0.0, 9.0, 4.0),)

    def __init__(self, robot, smoothed):
        super().__init__(robot, joint="hinge", limit=4.0, smoothed=smoothed)
        self.law = box(lambda k, x: -x.z[self.z], lambda k, x: x.z[self.z])

    def rates(self, k, x, u):
        return -3.0 * x.z[self.z]


@pytest.mark.parametrize("smoothed", [True, False])
def test_rows_see_the_states_of_their_part(smoothed):
    """The rod starts to fall when its friction has worn down to the weight."""
    scene = scene_from({"dt": 1e-3, "initial": {"position": {"hinge": 0.7}}}, urdf="pendulum")
    part = Worn(scene.robot, smoothed)
    part.name = "worn"
    scene = scene.holding(constraints=(part,))
    simulation = scene.simulation(integrator={"type": "rk4"})
    states = list(simulation.run(scene.initial, 0.5))
    begin = math.log(4.0 / (WEIGHT * math.sin(0.7))) / 3.0
    assert states[-1].z[0] == pytest.approx(4.0 * math.exp(-1.5), rel=1e-9)
    speeds = {x.t: abs(x.v[0]) for x in states}
    assert max(v for t, v in speeds.items() if t < begin - 2e-3) < 1e-9
    assert min(v for t, v in speeds.items() if t > begin + 0.02) > 1e-4
    if not smoothed:
        assert simulation.events[0].t == pytest.approx(begin, abs=1e-9)


def test_ticks_are_the_run_to_the_bit_and_a_reset_leaves_nothing_behind():
    scene = pendulum(integrator={"type": "adams"}, dt=1e-3)
    torques = 0.5 * np.sin(np.arange(100))[:, None]
    held = HeldTable(1e-3 * np.arange(100), torques)
    states = list(scene.simulation(sources={"drive": held}).run(scene.initial, 0.1))
    live = LiveSimulation(
        *(scene.simulation, scene.initial, 1e-3, CommandWatch(0.1, 0.1), scene.safe)
    )
    names = [output.name for output in live.showing.numbers]
    assert names[:2] == ["drive.angle", "drive.speed"]
    for _ in range(2):
        for torque, x in zip(torques, states[1:], strict=True):
            live.watch.take(torque)
            now = live.tick()
            assert now.position.tobytes() == x.q.tobytes()
            assert now.shown[:2].tobytes() == x.z.tobytes()
        live.reset()


def test_a_motor_that_asks_for_short_steps_is_named():
    scene = pendulum(actuators=[{**DRIVE, "rotor_inertia": 1e-9}], initial=None)
    said, system = [], scene.system()
    x = scene.simulation().start(scene.initial)
    watch = StallWatch(system, 1e3, said.append)
    watch.begin(x.t - 1e-6 * WINDOW)
    watch.check(x, None, 1e5)
    assert "drive.speed is stiff with a rate of" in said[0]


def test_the_drive_takes_symbols():
    robot = pendulum().robot
    symbols, u = Symbols(robot, nz=2), np.array([0.4])
    part = SeriesElasticDrive(robot, **{k: v for k, v in DRIVE.items() if k not in NOT_ITS_OWN})
    traced = [method(symbols.k, symbols.x, u) for method in (part.force, part.rates)]
    energy = part.potential(symbols.k, symbols.x)
    k = Kinematics(robot)
    for values in np.random.default_rng(4).normal(size=(5, 4)):
        x = State(0.0, values[:1], values[1:2], values[2:])
        for expression, method in zip(traced, (part.force, part.rates), strict=True):
            assert symbols.number(expression, x).ravel() == pytest.approx(method(k, x, u))
        assert symbols.number(energy, x).item() == pytest.approx(part.potential(k, x))


@pytest.mark.parametrize(
    ("states", "message"),
    [
        ((Internal("a", "", 0.0, 1.0, 2.0),), "many.a starts at 2, outside 0 .. 1"),
        ((Internal("a", "", 1.0, 0.0),), "many.a starts at 1, outside 1 .. 0"),
        ((Internal("a", ""), Internal("a", "")), "two internal states have the same name: many.a"),
    ],
)
def test_states_that_contradict_themselves_are_refused(states, message):
    part = Part()
    part.name, part.internal = "many", states
    with pytest.raises(ModelError, match=message):
        Internals([part])
