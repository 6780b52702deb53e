"""Phases that cannot be built, or that end in an error: each names what is wrong."""

import pytest
from mechanisms import four_bar, four_bar_closure
from phase_guards import GROUND, METHOD, slider

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import BAD_INPUT, FAILED, MbdError, SceneError, SolveError

FALL = {"until": {"hit": {"touch_down": "sole"}}, "then": "stand"}
SAME = {"slide": {"slide": 1.0}}
STAND = {"contacts": ["sole"], "until": {"rise": {"lift_off": "sole"}}, "then": "fall"}


def phases(fall=None, stand=None):
    """A fall and a stance, with other entries."""
    return {"fall": {**FALL, **(fall or {})}, "stand": {**STAND, **(stand or {})}}


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"fall": {"then": "fall"}}, ["phases.fall", "no guard ends it"]),
        (phases({"until": {}}), ["phases.fall", "no guard ends it", "touch_down"]),
        (phases({"then": "stnad"}), ["unknown phase 'stnad'", "stand"]),
        (phases({"then": None}), ["phases.fall.until.hit", "'then' is missing"]),
        (phases({"until": {"hit": {}}}), ["until.hit", "expected one of touch_down", "none"]),
        (
            phases({"until": {"hit": {"touch_down": "sole", "time": 1.0}}}),
            ["until.hit", "expected one of", "touch_down, time"],
        ),
        (phases({"until": {"hit": {"touch_down": "soul"}}}), ["unknown contact 'soul'", "sole"]),
        (phases({"until": {"hit": {"lift_off": "sole"}}}), ["contact that is held", "sole"]),
        (phases({"until": {"hit": {"joint": "slid"}}}), ["unknown joint 'slid'", "slide"]),
        (phases({"until": {"hit": {"joints": {}}}}), ["until.hit.joints", "no joint"]),
        (phases({"until": {"hit": {"joint": "slide", "way": "up"}}}), ["unknown key 'way'"]),
        (
            phases({"until": {"hit": {"joint": "slide", "direction": "left"}}}),
            ["direction", "up, down, both"],
        ),
        (
            phases({"until": {"hit": {"joint": "slide", "when": {"joint": "slide"}}}}),
            ["until.hit.when", "above, below"],
        ),
        (
            phases({"until": {"hit": {"joint": "slide", "when": {"above": 0.0}}}}),
            ["until.hit.when", "joint, joints"],
        ),
        (phases({"until": {"hit": {"multiplier": "sole.normal"}}}), ["phase fall", "sole.normal"]),
        (phases({"until": {"hit": {"time": -1.0}}}), ["until.hit.time", "out of range"]),
        (phases({"contacts": ["heel"]}), ["fall.contacts", "unknown contact 'heel'", "sole"]),
        (phases({"constraints": ["bar"]}), ["fall.constraints", "unknown constraint 'bar'"]),
        (phases({"couplings": ["knee"]}), ["fall.couplings", "unknown dependent joint 'knee'"]),
        (phases({"limit": 0.0}), ["fall.limit", "out of range"]),
        (phases({"reset": {"impact": ["heel"]}}), ["hit.reset.impact", "unknown rigid contact"]),
        (
            phases({"reset": {"exchange": {"slide": "knee"}}}),
            ["exchange", "unknown joint or internal state 'knee'"],
        ),
        (phases({"reset": {"relabel": {"slide": {}}}}), ["hit.reset", "cannot be told apart"]),
        (
            phases(
                {"reset": {"relabel": {"slide": {"slide": 1.0}}, "exchange": {"slide": "slide"}}}
            ),
            ["exchange.slide", "relabelled twice"],
        ),
    ],
)
def test_phases_that_cannot_be_built_are_refused_by_key(given, words):
    with pytest.raises(SceneError) as error:
        slider(given).simulation()
    assert all(word in str(error.value) for word in ("phases", *words)), str(error.value)


def test_start_in_an_unknown_phase_is_refused():
    with pytest.raises(SceneError, match=r"initial\.phase: unknown phase 'swing', there are"):
        slider(phases()).with_(initial={"phase": "swing"})


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"integrator": {"type": "semi_implicit_euler"}}, "does not stop at events.*fall"),
        ({"solver": {"type": "compiled"}}, "compiled does not serve phases"),
    ],
)
def test_methods_that_cannot_serve_phases_say_so(more, words):
    with pytest.raises(SceneError, match=words):
        slider(phases(), **more).simulation()


def test_compliant_contact_cannot_be_held():
    soft = {**GROUND, "type": "compliant", "stiffness": 1.0e4, "friction": 0.0}
    with pytest.raises(SceneError, match=r"stand\.contacts: sole is compliant.*held: false"):
        slider(phases(), contacts=[soft])


def test_guard_that_never_fires_ends_a_run_at_the_limit(tmp_path, capsys):
    """The exit code of a motion that ended early."""
    never = {"until": {"high": {"joint": "slide", "at": 9.0}}, "then": "fall", "limit": 0.25}
    with pytest.raises(MbdError, match=r"phase fall began at t = 0 s.*\(high\).*limit of 0.25 s"):
        slider({"fall": never}, height=2.0).simulate(1.0)
    (tmp_path / "scene.yaml").write_text(
        "robot: {urdf: package://mbd_ros/config/robots/pendulum.urdf}\n"
        "phases: {swing: {until: {high: {joint: hinge, at: 3.0}}, then: swing, limit: 0.5}}\n"
    )
    file = str(tmp_path / "scene.yaml")
    assert main(["simulate", file, "-t", "1", "-o", str(tmp_path / "motion.npz")]) == FAILED
    assert "phase swing" in capsys.readouterr().err


def test_unknown_name_is_bad_input_of_a_command(tmp_path, capsys):
    (tmp_path / "scene.yaml").write_text(
        "robot: {urdf: package://mbd_ros/config/robots/pendulum.urdf}\n"
        "phases: {swing: {until: {high: {joint: hing}}, then: swing}}\n"
    )
    assert main(["check", str(tmp_path / "scene.yaml")]) == BAD_INPUT
    assert "phases.swing.until.high.joint: unknown joint 'hing'" in capsys.readouterr().err


def test_reset_that_opens_a_loop_is_an_error_by_name():
    """A four-bar whose crank is moved on by 0.1 rad alone."""
    turn = {"until": {"late": {"time": 0.1}}, "then": "turn", "reset": {"shift": {"crank": 0.1}}}
    entries = {
        **{
            "constraints": [{"type": "loop_closure", **four_bar_closure()}],
            "phases": {"turn": turn},
            "integrator": METHOD,
        },
        **{"initial": {"position": {"crank": 1.0, "coupler": -0.5, "rocker": 1.2}}, "dt": 0.01},
    }
    scene = mbd.scene_from(entries, urdf=four_bar())
    with pytest.raises(MbdError, match=r"turn\.late leads to phase turn, whose row .* is .* open"):
        scene.simulate(0.2)


def test_contact_that_is_held_and_would_pull_or_slip_is_an_error_by_name():
    up = {"type": "joint_torque", "joint": "slide", "torque": 30.0}
    stand = {"contacts": ["sole"], "until": {"late": {"time": 9.0}}, "then": "stand"}
    scene = slider({"stand": stand}, forces=[up])
    with pytest.raises(SolveError, match=r"phase stand: contact sole is held and would pull"):
        scene.simulation().start(scene.initial)


def test_phases_without_end_at_one_time_are_an_error():
    at_once = {"until": {"now": {"time": 0.0}}}
    given = {"one": {**at_once, "then": "two"}, "two": {**at_once, "then": "one"}}
    with pytest.raises(MbdError, match="follow one another without end: one, two"):
        slider(given).simulate(0.1)
