"""Filippov solutions: closed forms, orders, uniqueness, and what is refused."""

import math
import subprocess
import sys

import numpy as np
import pytest
from mechanisms import scene_of
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.cli import main
from mbd_ros.core.loads.inputs import Sampled
from mbd_ros.core.state import State
from mbd_ros.errors import ModelError, SceneError, SolveError
from mbd_ros.files.tables.csv import read_table
from mbd_ros.methods.events.crossings import sign_change
from mbd_ros.methods.events.switching_surfaces import equivalent_signs, mode_on
from mbd_ros.parts.forces.switching_force import SwitchingForce
from mbd_ros.parts.integrators.filippov import Filippov
from mbd_ros.scene.schema import schema

SCENES = ROOT / "config/scenes"
PARABOLA = SCENES / "benchmark/s01_parabola.yaml"
HIT, EXIT = 0.75, 1.75  # s, S01_PARABOLA of the reference set: Filippov 1988, closed form
EXACT = {"type": "filippov", "tolerance": 1e-12}
PLANE = "robot: {urdf: ROBOTS/benchmark/point_in_plane.urdf, gravity: [0.0, 0.0, 0.0]}\n"


def parabola(t):
    """x, y, v_x, v_y of S01 as a point of 1 kg, whose velocity is the published motion."""
    v_x, tau = t - 0.25, t - EXIT
    x = 0.5 * t * t - 0.25 * t
    if t <= HIT:
        return x, t - 0.5 * t * t, v_x, 1.0 - t
    if t <= EXIT:
        return x, 0.46875 + (v_x**3 - 0.125) / 3.0, v_x, v_x**2
    return x, 0.46875 + 3.25 / 3.0 + 2.25 * tau + 1.5 * tau**2, v_x, 2.25 + 3.0 * tau


@pytest.fixture
def scene():
    def built(text):
        return scene_of(text.replace("ROBOTS", str(ROOT / "config/robots")))

    return built


def relay(joint, size, **more):
    """Entry of a force -size sign(velocity of joint)."""
    force = {"type": "switching_force", "velocity": {joint: [0.0, 1.0]}}
    return force | {"above": {joint: -size}, "below": {joint: size}} | more


def run(loaded, duration, integrator=EXACT, dt=0.01, commands=None):
    names = [part.name for part in loaded.actuators]
    sources = {} if commands is None else dict.fromkeys(names, Sampled(commands, dt))
    simulation = loaded.simulation(integrator=integrator, dt=dt, sources=sources)
    return simulation, list(simulation.run(loaded.initial, duration))


def modes(simulation):
    """When each mode began, and the modes."""
    events = simulation.events
    times, found = [0.0], [events[0].before.mode if events else simulation.stepper.field.mode]
    for event in events:
        if event.after.mode != found[-1]:
            times.append(event.t)
            found.append(event.after.mode)
    return np.array(times), found


def test_parabola_to_rounding_with_entry_and_exit():
    """1e-13: some ten steps of rounding; the method is exact for these polynomials."""
    loaded = load_scene(PARABOLA)
    simulation = loaded.simulation()
    states = list(simulation.run(loaded.initial, 2.5))
    for x in states:
        assert [*x.q, *x.v] == pytest.approx(parabola(x.t), abs=1e-13)
        now, a = simulation.system.evaluate(x), np.empty(2)
        simulation.system.accelerator(x.mode)(x.t, x.q, x.v, None, a)
        assert len(x.mode) == 1 and np.array_equal(a, now.a)
        if HIT <= x.t <= EXIT:
            assert abs(x.v[1] - x.v[0] ** 2) <= 1e-15
            weight = (now.a[1] - 3.0) / (-1.0 - 3.0)
            assert weight == pytest.approx((3.0 - 2.0 * x.v[0]) / 4.0, abs=1e-13)
    times, found = modes(simulation)
    assert found == [(1,), (0,), (-1,)]
    assert times == pytest.approx([0.0, HIT, EXIT], abs=1e-14)
    assert len(states) == 51 and simulation.steps <= 10


@pytest.mark.parametrize("dt", [0.05, 0.011, 2.5])
@pytest.mark.parametrize("tolerance", [None, 1e-6])
def test_parabola_whatever_the_step(dt, tolerance):
    loaded = load_scene(PARABOLA)
    simulation, states = run(loaded, 2.5, {"type": "filippov", "tolerance": tolerance}, dt)
    assert max(np.abs([*x.q, *x.v] - np.array(parabola(x.t))).max() for x in states) <= 1e-12
    assert modes(simulation)[0] == pytest.approx([0.0, HIT, EXIT], abs=1e-13)


def test_parabola_through_the_command_line(capsys, tmp_path):
    out = tmp_path / "out.csv"
    assert main(["simulate", str(PARABOLA), "-t", "2.5", "-o", str(out)]) == 0
    assert "Filippov, tier aba" in capsys.readouterr().out
    table = read_table(out)
    columns = dict(zip(table.columns, table.values.T, strict=True))
    fields = ("x.position", "y.position", "x.velocity", "y.velocity")
    expected = np.array([parabola(t) for t in columns["time"]])
    assert np.column_stack([columns[f] for f in fields]) == pytest.approx(expected, abs=1e-8)
    slides = (columns["time"] > HIT) & (columns["time"] < EXIT)
    v_x = columns["x.velocity"][slides]
    assert columns["y.acceleration"][slides] == pytest.approx(2.0 * v_x, abs=1e-8)
    assert main(["check", str(PARABOLA)]) == 0


def test_other_methods_chatter_along_the_parabola():
    """|h| <= 4 dt while sliding, as the reference file says of time stepping."""
    for dt in (0.01, 0.001):
        _, states = run(load_scene(PARABOLA), 2.5, {"type": "rk4"}, dt)
        sliding = [x for x in states if HIT + 0.1 < x.t < EXIT - 0.1]
        assert max(abs(x.v[1] - x.v[0] ** 2) for x in sliding) <= 4.0 * dt


@pytest.mark.parametrize("tolerance", [None, 1e-9])
def test_smooth_scene_integrates_as_with_dop853(tolerance):
    loaded = load_scene(SCENES / "empty.yaml")
    start = loaded.initial._replace(q=np.array([1.0]))
    pairs = zip(
        *(
            loaded.simulation(integrator={"type": kind, "tolerance": tolerance}).run(start, 0.1)
            for kind in ("filippov", "dop853")
        ),
        strict=True,
    )
    assert all(np.array_equal(a.q, b.q) and np.array_equal(a.v, b.v) for a, b in pairs)


DRAGGED = """
robot: {urdf: ROBOTS/pendulum.urdf}
forces:
- {type: switching_force, velocity: {hinge: [-0.6, 1.0]}, position: {hinge: [0.0, 2.0]},
   time: [0.0, -1.2], above: {hinge: -3.0}, below: {hinge: 3.0}}
- {type: switching_force, position: {hinge: [-0.45, 1.0]}, above: {hinge: -0.4}, below: {}}
initial: {position: {hinge: -0.2}, velocity: {hinge: -6.0}}
"""


def test_order_is_kept_through_events(scene):
    """A crossing, reaching, sliding, a crossing while it slides, exit: none costs an order."""

    def result(dt):
        simulation, states = run(loaded, 2.0, {"type": "filippov"}, dt)
        times, found = modes(simulation)
        assert found == [(-1, -1), (1, -1), (0, -1), (0, 1), (-1, 1)]
        return np.array([*states[-1].q, *states[-1].v, *times])

    loaded = scene(DRAGGED)
    exact = result(0.0125)
    coarse, fine = (np.abs(result(dt) - exact) for dt in (0.4, 0.05))
    assert fine.max() <= 5e-12
    assert np.log2(coarse[:2].max() / fine[:2].max()) / 3 == pytest.approx(8.0, abs=0.5)
    assert (np.log2(coarse[3:] / fine[3:]) / 3 >= 7.0).all()


def test_surface_is_kept_to_rounding_while_sliding_on_a_moving_one(scene):
    loaded = scene(DRAGGED)
    simulation, states = run(loaded, 2.0, {"type": "filippov", "tolerance": 1e-6})
    (*_, hit, _, leave), _ = modes(simulation)
    heights = [x.v[0] - 0.6 + 2.0 * x.q[0] - 1.2 * x.t for x in states if hit < x.t < leave]
    assert len(heights) > 30
    assert np.abs(heights).max() <= 1e-15


def test_friction_sticks_and_lets_go_like_the_exact_one(scene):
    """1 kg at 0.5 m/s, friction 1 N, a pull of 0.4 N/s t: closed form, and `dry_friction`.

    The bounded row comes to rest within its time constant, hence 2e-3.
    """
    pull = """forces:
- {type: prescribed_torque, joints: [x], times: [0.0, 5.0], torque: [[0.0], [2.0]]}
"""
    start = "initial: {velocity: {x: 0.5}}\n"
    loaded = scene(f"{PLANE}{pull}- {relay('x', 1.0)}\n{start}")
    simulation, states = run(loaded, 4.0)
    stop = (1.0 - math.sqrt(1.0 - 0.4)) / 0.4  # 0.5 - t + 0.2 t^2 = 0
    times, found = modes(simulation)
    assert found == [(1,), (0,), (1,)]
    assert times == pytest.approx([0.0, stop, 2.5], abs=1e-12)
    assert max(abs(x.v[0]) for x in states if stop < x.t < 2.5) <= 1e-16
    assert states[-1].v[0] == pytest.approx(0.2 * 1.5**2, abs=1e-12)
    rows = "constraints: [{type: dry_friction, joint: x, limit: 1.0}]\n"
    _, exact = run(scene(f"{PLANE}{pull}{rows}{start}"), 4.0, {"type": "dopri5"}, 1e-3)
    assert max(abs(x.v[0] - y.v[0]) for x, y in zip(states, exact[::10], strict=True)) <= 2e-3


def test_commands_that_change_end_sticking(scene):
    """Commands of 0.9, 1.5 and 0.9 N against 1 N of friction, each for 1 s."""
    drive = "actuators: [{type: ideal, joints: [x]}]\n"
    loaded = scene(f"{PLANE}{drive}forces: [{relay('x', 1.0)}]\n")
    levels = [0.9, 1.5, 0.9, 0.9]
    simulation, states = run(
        loaded, 9.0, dt=0.1, commands=lambda t: np.array([levels[min(int(t + 1e-9), 3)]])
    )
    times, found = modes(simulation)
    assert found == [(0,), (1,), (0,)]
    assert times == pytest.approx([0.0, 1.0, 7.0], abs=1e-12)
    assert states[-1].q[0] == pytest.approx(0.25 + 1.25, abs=1e-12)


def test_relay_reaches_zero_in_time(scene):
    """S03_RELAY of the reference set: |x0| / K without disturbance."""
    simulation, states = run(
        scene(f"{PLANE}forces: [{relay('x', 1.0)}]\ninitial: {{velocity: {{x: 1.0}}}}"), 2.0
    )
    assert modes(simulation)[0] == pytest.approx([0.0, 1.0], abs=1e-14)
    assert states[-1].v[0] == 0.0


def test_a_dip_within_one_step_is_seen(scene):
    """y = 1e-3 - 0.1 t + t^2 is below 0 for sqrt(0.006) s; x is pushed with 1 N there."""
    text = f"""{PLANE}forces:
- {{type: joint_torque, joint: y, torque: 2.0}}
- {{type: switching_force, position: {{y: [0.0, 1.0]}}, above: {{}}, below: {{x: 1.0}}}}
initial: {{position: {{y: 1.0e-3}}, velocity: {{y: -0.1}}}}
"""
    simulation, states = run(scene(text), 5.0, dt=5.0)
    root = math.sqrt(0.006)
    assert states[-1].v[0] == pytest.approx(root, abs=1e-12)
    assert modes(simulation)[0] == pytest.approx([0, 0.05 - root / 2, 0.05 + root / 2], abs=1e-12)


def test_two_surfaces_at_once(scene):
    """Two coupled relays: v_x' = -2 s_x + s_y, v_y' = s_x / 2 - s_y, both reached at 1 s."""
    text = f"""{PLANE}forces:
- {relay("x", 2.0, above={"x": -2.0, "y": 0.5}, below={"x": 2.0, "y": -0.5})}
- {relay("y", 1.0, above={"y": -1.0, "x": 1.0}, below={"y": 1.0, "x": -1.0})}
initial: {{velocity: {{x: 1.0, y: 0.5}}}}
"""
    simulation, states = run(scene(text), 2.0)
    times, found = modes(simulation)
    assert (found[0], found[-1]) == ((1, 1), (0, 0))
    assert times[1:] == pytest.approx(1.0, abs=1e-14)
    assert np.abs(states[-1].v).max() <= 1e-15
    assert states[-1].q == pytest.approx([0.5, 0.25], abs=1e-13)


@pytest.mark.parametrize(
    ("r", "D", "mode"),
    [
        ([0.5], [[-1.0]], (0,)),  # attractive
        ([1.5], [[-1.0]], (1,)),  # crossed upwards
        ([-1.5], [[0.2]], (-1,)),  # crossed downwards
        ([1.0], [[-1.0]], (0,)),  # tangent: sliding first
        ([0.5, 3.0], [[-1.0, 0.0], [0.0, -1.0]], (0, 1)),
        ([0.5, 0.0], [[-1.0, 0.3], [0.4, -1.0]], (0, 0)),
        ([1.2, 1.2], [[-1.0, 0.5], [-1.0, -1.0]], (1, 0)),
    ],
)
def test_mode_on_surfaces(r, D, mode):
    assert mode_on(np.array(r), np.array(D), ["a", "b"][: len(r)]) == mode


@pytest.mark.parametrize(
    ("r", "D", "message"),
    [
        (
            [0.5],
            [[1.0]],
            "surface a: the solution is not unique, it may go on on it; above; below",
        ),
        ([0.0], [[0.0]], "not unique"),
        ([0.0, 0.0], [[-1.0, 2.0], [2.0, -1.0]], "surface a, b: the solution is not unique"),
        ([0.0] * 7, np.eye(7), "7 switching surfaces at once"),
    ],
)
def test_what_is_not_unique_is_refused(r, D, message):
    names = list("abcdefg")[: len(r)]
    with pytest.raises(SolveError, match=message):
        mode_on(np.array(r), np.array(D), names)


def test_signs_of_a_force_that_does_not_act_across_are_refused():
    with pytest.raises(SolveError, match="surface a: no force keeps a motion on it"):
        equivalent_signs(np.array([1.0]), np.array([[0.0]]), ["a"])


def test_start_on_a_surface_that_repels_is_refused(scene):
    simulation = (loaded := scene(f"{PLANE}forces: [{relay('x', -1.0)}]")).simulation(
        integrator=EXACT
    )
    with pytest.raises(SolveError, match="t = 0 s: switching surface h of x: the solution is not"):
        list(simulation.run(loaded.initial, 1.0))


def spiral(scene, turn):
    """Relays v_x' = -s_x + turn s_y, v_y' = -turn s_x - s_y: at rest after infinitely many
    switches, each quarter turn (turn - 1) / (turn + 1) times as long as the last one.
    """
    cross = {"above": {"x": turn, "y": -1.0}, "below": {"x": -turn, "y": 1.0}}
    loaded = scene(f"""{PLANE}forces:
- {relay("x", 1.0, above={"x": -1.0, "y": -turn}, below={"x": 1.0, "y": turn})}
- {relay("y", 1.0, **cross)}
initial: {{velocity: {{x: 1.0, y: -1.0e-3}}}}
""")
    return run(loaded, 2.0)


def test_a_spiral_of_switches_into_two_surfaces_ends_there(scene):
    simulation, states = spiral(scene, 1.5)
    times, found = modes(simulation)
    assert found[-1] == (0, 0) and len(found) > 10
    assert np.abs(states[-1].v).max() <= 1e-12
    sizes = np.diff(times)[2:-2]
    assert sizes[1:] / sizes[:-1] == pytest.approx(0.2, rel=1e-2)


def test_events_that_accumulate_are_refused(scene):
    with pytest.raises(SolveError, match=r"t = .*: 21 switching events, .* accumulate \(Zeno\)"):
        spiral(scene, 5.0)


def test_twisting_ends_where_events_accumulate(scene):
    """It rests after infinitely many switches, at 4.4614 s; heights are known to 1e-12."""
    text = f"""{PLANE}forces:
- {{type: switching_force, position: {{x: [0.0, 1.0]}}, above: {{x: -2.0}}, below: {{x: 2.0}}}}
- {relay("x", 1.0)}
initial: {{position: {{x: 1.0}}}}
"""
    with pytest.raises(SolveError, match=r"accumulate there \(Zeno\)") as caught:
        run(scene(text), 5.0)
    end = math.sqrt(2.0) * 4.0 / 3.0 / (1.0 - math.sqrt(1.0 / 3.0))
    last = float(str(caught.value).split("t = ")[1].split(" s")[0])
    assert last == pytest.approx(end, abs=1e-5)


def test_bounded_rows_beside_it_are_refused(scene):
    rows = "constraints: [{type: dry_friction, joint: y, limit: 1.0, smoothed: true}]\n"
    loaded = scene(f"{PLANE}{rows}forces: [{relay('x', 1.0)}]")
    with pytest.raises(SceneError, match=r"beside bounded rows \(y_dry_friction.force\)"):
        loaded.simulation(integrator=EXACT)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"velocity": {}}, "velocity and position are missing"),
        ({"above": {"x": 1.0}, "below": {"x": 1.0}}, "so no force switches"),
        ({"above": {"x": math.nan}}, r"here.above.x: nan is out of range"),
        ({"velocity": {"z": [0.0, 1.0]}}, "no joint 'z'"),
    ],
)
def test_entry_that_makes_no_sense_is_refused(scene, entry, message):
    robot = scene(PLANE).robot
    given = {key: v for key, v in (relay("x", 1.0) | entry).items() if key != "type"}
    with pytest.raises(SceneError, match=message):
        schema.call(SwitchingForce, given, "here", robot)
    with pytest.raises(ModelError, match="tolerance"):
        Filippov(tolerance=1e-15)


def test_rate_is_that_of_the_height(scene):
    part = SwitchingForce(
        scene(PLANE).robot,
        velocity={"x": [0.1, -0.4, 0.7]},
        position={"x": [0.3, 0.2, 0.0, 1.1], "y": [0.0, 0.0, 2.0]},
        time=[0.0, 0.5, -0.2],
        above={"x": 1.0},
        below={},
    )
    a, h = np.array([0.3, -0.8]), 1e-5
    x = State(0.4, np.array([0.2, -0.5]), np.array([0.9, 0.6]))
    ends = [State(x.t + s, x.q + s * x.v + 0.5 * s * s * a, x.v + s * a) for s in (-h, h)]
    below, above = (part.heights(None, end) for end in ends)
    assert part.rates(None, x, a) == pytest.approx((above - below) / (2 * h), abs=1e-9)


def arm(scene, solver):
    """Two relays on the arm whose elbow follows the shoulder, and their s = v + 2 q - c."""
    loaded = scene(f"""
robot: {{urdf: ROBOTS/prosthetic_arm.urdf}}
couplings: {{elbow: {{parent: shoulder_flexion, factor: 1.75, offset: 0.175}}}}
solver: {{type: {solver}}}
forces:
- {relay("shoulder_flexion", 12.0, position={"shoulder_flexion": [-1.0, 2.0]})}
- {relay("shoulder_abduction", 9.0, position={"shoulder_abduction": [-0.5, 2.0]})}
""")
    joints = [loaded.robot.joint(name) for name in ("shoulder_flexion", "shoulder_abduction")]
    q, v = [joint.q for joint in joints], [joint.v for joint in joints]
    return loaded, q, v, lambda x: x.v[v] + 2.0 * x.q[q] - [1.0, 0.5]


ARM = {"type": "filippov", "tolerance": 1e-10}


@pytest.mark.parametrize(("solver", "kept"), [("reduced", 1e-15), ("kkt", 1e-10)])
def test_coupled_joints_slide_in_every_tier(scene, solver, kept):
    """Heights hold to rounding, or to what projection onto the rows moves."""
    loaded, _, v, height = arm(scene, solver)
    simulation, states = run(loaded, 1.0, ARM, 0.05)
    times, found = modes(simulation)
    assert found[-1] == (0, 0) and times[-1] < 0.2
    x = states[-1]
    assert np.abs(height(x)).max() <= kept
    a = simulation.system.evaluate(x).a
    assert a[v] + 2.0 * x.v[v] == pytest.approx([0.0, 0.0], abs=1e-9)
    other = arm(scene, {"reduced": "kkt", "kkt": "reduced"}[solver])[0]
    assert x.q == pytest.approx(run(other, 1.0, ARM, 0.05)[1][-1].q, abs=1e-8)


@pytest.mark.parametrize("solver", ["reduced", "kkt"])
def test_ticks_give_the_same_motion(scene, solver):
    """As the simulator runs it: corrected states, and no dense output."""
    loaded = arm(scene, solver)[0]
    simulation = loaded.simulation(integrator=ARM, dt=0.05)
    y = simulation.start(loaded.initial)
    for k in range(1, 101):
        y = simulation.advance(y, None, 0.01 * k)
    same, states = run(loaded, 1.0, ARM, 0.05)
    assert simulation.system.expand(y).q == pytest.approx(states[-1].q, abs=1e-9)
    assert modes(simulation)[1] == modes(same)[1]
    assert modes(simulation)[0] == pytest.approx(modes(same)[0], abs=1e-9)


@pytest.mark.parametrize(
    ("f", "root"), [(math.cos, math.pi / 2), (lambda x: (x - 0.3) ** 3, 0.3), (lambda x: x - 1, 1)]
)
def test_sign_change_is_found_to_rounding(f, root):
    assert sign_change(f, (0.0, f(0.0)), (2.0, f(2.0))) == pytest.approx(root, abs=4e-16)


def test_scenes_without_it_import_nothing_of_it():
    code = "import sys; from mbd_ros.cli import main; main(['check', sys.argv[1]]); "
    code += "sys.exit(any('switching' in m or 'sliding_field' in m for m in sys.modules))"
    words = [sys.executable, "-c", code, str(SCENES / "prosthetic_arm.yaml")]
    assert subprocess.run(words, cwd=ROOT, stdout=subprocess.DEVNULL).returncode == 0
