"""`mbd-ros gait` on walkers that are mechanisms of this package."""

import math

import numpy as np
import pytest
from plain_walkers import round_foot_walker

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import FallError, SceneError
from mbd_ros.features.gait.periodic import ReturnMap, periodic_motion
from mbd_ros.files.table import read_result
from mbd_ros.methods.sensitivities.flow import Travel

# Fixed points without foot mass in 80-bit arithmetic, beyond the digits of Garcia et al. 1998.
LEGS = ("left", "right")
LIMIT = {  # slope, theta, thetadot, phidot, period, multipliers
    "long": (
        *(0.009, 0.20031090054424709, -0.19983247300495235, -0.01582299994830938),
        *(3.882463752851374, [-0.190099841066 + 0.557598776682j]),
    ),
    "short": (
        *(0.009, 0.19393736981018181, -0.20386692744200692, -0.01514426085319157),
        *(3.096105868078164, [4.003864358929707, 0.45958958979767156]),
    ),
    "long, gentle": (
        *(0.004, 0.15338956487623631, -0.15608014667568143, -0.00728719744912350),
        *(3.852613461750981, [0.22888996288846 + 0.59115519468348j]),
    ),
    "short, gentle": (
        *(0.004, 0.14877838696961965, -0.15880667345760565, -0.00697865449899189),
        *(3.116505598348014, [3.2127693876334282, 0.5915522469844745]),
    ),
}


def walker(slope, foot, start):
    """The simplest walker; start is theta, thetadot, phidot as in the literature."""
    scene = mbd.load_scene("simplest_walker_step")
    inertia = np.zeros((3, 3))
    feet = {leg: (foot, [0.0, 0.0, -1.0], inertia) for leg in ("left_leg", "right_leg")}
    th, thd, phid = start
    position = {"travel": -math.sin(th), "height": math.cos(th), "left_hip": -th, "right_hip": th}
    velocity = {
        "travel": -math.cos(th) * thd,
        "height": -math.sin(th) * thd,
        "left_hip": -thd,
        "right_hip": phid - thd,
    }
    gravity = [math.sin(slope), 0.0, -math.cos(slope)]
    return scene.with_(
        robot={**scene.entries["robot"], "gravity": gravity},
        initial={"position": position, "velocity": velocity},
    ).with_inertias(feet)


def state_of(result, row=0):
    """theta, thetadot, phidot and period."""
    gaits = result["gaits"]
    left, right = (gaits[f"{side}_hip.velocity"][row] for side in ("left", "right"))
    place = -gaits["left_hip.position"][row]
    return np.array([place, -left, right - left, gaits["period"][row]])


def multipliers_of(result, count, row=0):
    gaits = result["gaits"]
    pairs = ((gaits[f"multiplier_{i}.{p}"][row] for p in ("real", "imaginary")) for i in (1, 2))
    return np.array([complex(*pair) for pair in pairs])[:count]


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.soak] if "gentle" in n else []) for n in LIMIT]
)
def test_the_simplest_walker_as_a_mechanism(name):
    """States and multipliers in the limit of feet without mass, by the trend from two masses.

    A mass matrix with feet of 1e-9 would leave 1e-7 of accelerations; with these two the trend
    errs by 1.6e-9 times a second derivative of some ones.
    """
    slope, *state, period, expected = LIMIT[name]
    states, found = [], []
    for foot in (2e-5, 4e-5):
        result = walker(slope, foot, [round(x, 4) for x in state]).gait()
        states.append(state_of(result))
        found.append(multipliers_of(result, len(expected)))
    assert 2.0 * states[0] - states[1] == pytest.approx([*state, period], abs=1e-8)
    assert 2.0 * found[0] - found[1] == pytest.approx(expected, abs=1e-6)
    assert bool(result["gaits"]["stable"][0]) == name.startswith("long")


@pytest.mark.soak
def test_round_feet_roll_as_plain_equations_do():
    """Against equations and angular momenta written down for this walker alone."""
    plain = round_foot_walker()
    at = plain.cycle(plain.state([0.19, -0.19, -0.239, -0.188]))[-1]
    expected = periodic_motion(ReturnMap(plain, at, Travel()), at.end)
    gaits = mbd.load_scene("round_foot_walker").gait()["gaits"]
    found = [-gaits[f"{leg}_hip.{q}"][0] for q in ("position", "velocity") for leg in LEGS]
    state = np.concatenate((expected.state.q, expected.state.v))
    assert found == pytest.approx(state, abs=1e-9)
    assert gaits["period"][0] == pytest.approx(expected.passage.period, abs=1e-9)
    values = [gaits[f"multiplier_{i}.{p}"][0] for p in ("real", "imaginary") for i in (1, 2, 3)]
    assert values == pytest.approx(
        [*expected.multipliers[:3].real, *expected.multipliers[:3].imag], abs=1e-8
    )


def test_a_walker_with_knees_walks_as_published():
    """V. F. Hsu Chen, MIT 2007, sec. 3.3: four digits of runs with steps of 1 ms.

    The interleg angle of 0.4761 rad and the period of 0.559 s +- 2 % (read from fig. 3-4).
    """
    result = mbd.load_scene("kneed_walker").gait()
    gaits = result["gaits"]
    assert bool(gaits["stable"][0])
    assert gaits["left_hip.position"][0] == pytest.approx(-0.2381, rel=5e-3)
    assert gaits["left_hip.velocity"][0] == pytest.approx(1.1014, rel=1e-2)
    assert gaits["period"][0] == pytest.approx(0.559, rel=2e-2)
    bent = result["samples"]["right_knee.position"]
    assert bent.max() > 0.2 and bent.min() > -1e-9
    assert np.abs(result["samples"]["left_knee.position"]).max() < 1e-9


@pytest.mark.soak
def test_a_push_off_walks_on_the_level():
    """Ankle and hip give over a cycle what the strikes take; their memory is part of the gait."""
    scene = mbd.load_scene("level_walker")
    assert scene.robot.model.gravity.linear[0] == 0.0
    gaits = scene.gait()["gaits"]
    given = gaits["positive_work"][0] + gaits["negative_work"][0]
    assert given == pytest.approx(gaits["energy_lost"][0], rel=1e-5)
    assert gaits["travel"][0] > 0.1 and gaits["cost_of_transport"][0] > 0.0
    assert bool(gaits["stable"][0]) and 0.0 < gaits["ankle.activation"][0] < 1.0


TASK = """\
gait:
  guesses:
  - {}
  - {velocity: {left_hip: 0.2}}
  continuation: {parameter: slope, from: 0.009, to: 0.0091}
  basin: {grid: {left_hip.velocity: [0.1, 0.2, 2]}, cycles: 40}
"""


@pytest.mark.soak  # the page on gaits runs such a task, too
def test_a_task_gives_gaits_branches_and_a_basin_in_files(tmp_path, capsys):
    (tmp_path / "walk.yaml").write_text(TASK, encoding="utf-8")
    places = [str(tmp_path / name) for name in ("walk.yaml", "out.csv", "out.html")]
    words = ["gait", "simplest_walker_step", places[0], "-o", places[1], "--page", places[2]]
    assert main([*words, "--workers", "1"]) == 0
    said = capsys.readouterr().out
    assert said.count("gait 1: stable, period 3.88246") == 1 and "gait 2" not in said
    assert "stable for slope 0.009 .. 0.0091" in said
    table = np.genfromtxt(tmp_path / "out.branches.csv", delimiter=",", names=True)
    assert table["parameter"][[0, -1]] == pytest.approx([0.009, 0.0091], abs=1e-15)
    assert np.all(np.diff(table["parameter"]) > 0.0)
    basin = np.genfromtxt(tmp_path / "out.basin.csv", delimiter=",", names=True)
    assert basin["outcome"].tolist() == [0.0, 1.0]
    motion = read_result(tmp_path / "out.csv")["samples"]
    assert motion["time"][[0, -1]] == pytest.approx([0.0, 3.88246], abs=1e-5)
    page = (tmp_path / "out.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 2 and "<script" not in page


def test_a_wheel_with_inertia_keeps_the_square_of_its_loss():
    """Through a real impact: w+ = e w-, so the multiplier is e^2; period by its own energy."""
    inertia, turn = 0.1, math.pi / 4.0
    wheel = mbd.load_scene("rimless_wheel")
    wheel = wheel.with_inertias({"hub": (1.0, np.zeros(3), np.diag([inertia] * 3))})
    result = wheel.gait()
    keeps = (inertia + math.cos(turn)) / (inertia + 1.0)
    assert multipliers_of_first(result) == pytest.approx(keeps**2, abs=1e-9)
    fall = 2.0 * 9.81 * 2.0 * math.sin(math.pi / 8.0) * math.sin(0.08) / (1.0 + inertia)
    after = keeps * math.sqrt(fall / (1.0 - keeps**2))
    gaits = result["gaits"]
    assert gaits["wheel.velocity"][0] == pytest.approx(after, rel=1e-9)
    assert gaits["travel"][0] == pytest.approx(2.0 * math.sin(math.pi / 8.0), rel=1e-9)
    lost = 0.5 * (1.0 + inertia) * (1.0 / keeps**2 - 1.0) * after**2
    assert gaits["energy_lost"][0] == pytest.approx(lost, rel=1e-9)


def multipliers_of_first(result):
    return result["gaits"]["multiplier_1.real"][0]


def test_two_named_steps_are_a_cycle_of_two():
    """Left and right stance: the multipliers of one step, squared."""
    feet = dict.fromkeys(("left_leg", "right_leg"), (1e-3, [0.0, 0.0, -1.0], np.zeros((3, 3))))
    scenes = (mbd.load_scene(f"simplest_walker{word}") for word in ("_step", ""))
    one, two = (scene.with_inertias(feet).gait() for scene in scenes)
    assert two["gaits"]["period"][0] == pytest.approx(2.0 * one["gaits"]["period"][0], rel=1e-9)
    expected = multipliers_of(one, 2) ** 2
    assert sorted(multipliers_of(two, 2), key=lambda m: m.imag) == pytest.approx(
        sorted(expected, key=lambda m: m.imag), abs=1e-6
    )


BAD = {
    "{event: strik}": "no event is called 'strik', there are: step.strike",
    "{travel: [ways]}": "gait.travel: 'ways' does not travel, there are: travel, height",
    "{search: {left_hip: [0, 1, 3]}}": "expected <joint>.position or <joint>.velocity",
    "{search: {left_hip.position: [0, 1]}}": r"expected \\[low, high, number of values\\]",
    "{search: {hip.position: [0, 1, 2]}}": "hip.position: .*hip",
    "{continuation: {parameter: slope, from: 0.01, to: 0.02}}": "slope is 0.009 in the scene",
    "{continuation: {parameter: slop.e, from: 0.01, to: 0.02}}": "nothing is called 'slop'",
    "{continuation: {parameter: slope, from: 0.01, to: 0.01}}": "from and to must differ",
    "{guesses: [{velocity: {knee: 1.0}}]}": "guesses.0.: .*knee",
    "{guesses: [{speed: 1.0}]}": "unknown key 'speed'",
    "{step_between: [left_leg]}": "expected two frames",
    "{step_between: [left_leg, leg]}": "leg",
    "{longest: 0}": "longest: 0 is out of range",
    "{cycle: 1}": "unknown key 'cycle'",
}


@pytest.mark.parametrize("entry", BAD)
def test_a_task_that_does_not_fit_is_refused(tmp_path, entry):
    (tmp_path / "walk.yaml").write_text(f"gait: {entry}\n", encoding="utf-8")
    with pytest.raises(SceneError, match=BAD[entry].replace("\\\\", "\\")):
        mbd.load_scene("simplest_walker_step").gait(tmp_path / "walk.yaml")


def test_a_guess_from_which_nobody_walks_says_so():
    scene = mbd.load_scene("simplest_walker_step").with_({"initial.velocity.travel": -0.2})
    with pytest.raises(FallError, match="not one cycle can be simulated"):
        scene.gait({"longest": 5.0})


def test_a_scene_without_events_has_no_gait():
    with pytest.raises(SceneError, match="has no events that could end a cycle"):
        mbd.load_scene("prosthetic_arm").gait()
