"""Feet on the ground without force plates: contacts whose forces are unknowns."""

import math

import numpy as np
import pytest
from mechanisms import joint, link, urdf
from places import RECORDINGS

import mbd_ros as mbd
from mbd_ros import read_result
from mbd_ros.errors import DataError
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.motion.stance import trailing_force

G = 9.81
SIDES = {"left": 0.15, "right": -0.15}


def slides(side, y):
    """A foot below the trunk on three slides."""
    names = [f"{side}_{axis}" for axis in "xyz"]
    bodies = [f"{side}_1", f"{side}_2", f"{side}_foot"]
    moments = (0.01, 0.01, 0.01)
    parts = [link(bodies[0], 1.0, (0, 0, 0), moments), link(bodies[1], 1.0, (0, 0, 0), moments)]
    parts.append(link(bodies[2], 2.0, (0.02, 0.0, 0.05), moments))
    places = (0.0, y, -0.9), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    axes, parents = np.eye(3), ("trunk", *bodies[:2])
    each = zip(names, parents, bodies, axes, places, strict=True)
    return [*parts, *(joint(n, "prismatic", p, c, axis, at) for n, p, c, axis, at in each)]


BIPED = urdf(
    link("trunk", 30.0, (0.0, 0.0, 0.1), (2.0, 2.0, 1.0)),
    *(part for side, y in SIDES.items() for part in slides(side, y)),
)
FEET = (("left", 1, 0.8), ("right", -1, 0.4))  # one leaves at 0.8 s, the other comes at 0.4 s
FIELDS = ("position", "velocity", "acceleration")
JOINTS = [f"{side}_{axis}" for side in SIDES for axis in "xyz"]
SOLE = [[0.15, 0.06, 0.0], [0.15, -0.06, 0.0], [-0.1, -0.06, 0.0], [-0.1, 0.06, 0.0]]


def biped(away=(0.0, 0.0, 0.0), sides=tuple(SIDES), **more):
    """A trunk on two feet that slide below it; nothing but the ground carries it."""
    ground = {"half_space": [0.0, 0.0, 1.0], "xyz": list(away)}
    contacts = [
        {
            "type": "rigid",
            "name": f"{side}_sole",
            "between": [{"frame": f"{side}_foot", "points": SOLE}, ground],
            "friction": 0.7,
        }
        for side in sides
    ]
    sections = {"robot": {"base": "floating"}, "contacts": contacts}
    return mbd.scene_from(sections | more, urdf=BIPED)


def sway(away=(0.0, 0.0, 0.0), lifted=0.05, reverse=False):
    """The trunk goes from over the left foot to over the right one, which step on and off.

    Feet do not turn and do not slip: joints are the way of the foot less that of the trunk.
    """
    t, s = np.linspace(0.0, 1.2, 61), np.pi / 1.2
    across = 0.15 * np.cos(s * t), -0.15 * s * np.sin(s * t), -0.15 * s**2 * np.cos(s * t)
    trunk = {"x": (0.1 * t, 0.1 + 0 * t, 0 * t), "y": across, "z": (0.9 + 0 * t, 0 * t, 0 * t)}
    rows = {}
    for side, sign, at in FEET:
        up, steep = np.maximum(sign * (t - at), 0.0), lifted / 0.09
        height, rise, push = steep * up**2, 2 * steep * up * sign, 2 * steep * (up > 0)
        for axis, foot in zip("xyz", ((0, 0, 0), (0, 0, 0), (height, rise, push)), strict=True):
            for field, f, b in zip(FIELDS, foot, trunk[axis], strict=True):
                shift = 0.9 if (axis, field) == ("z", "position") else 0.0
                rows[f"{side}_{axis}.{field}"] = f - b + shift
    bodies = "position", "linear_velocity", "linear_acceleration"
    for axis in "xyz":
        for field, value in zip(bodies, trunk[axis], strict=True):
            shift = away["xyz".index(axis)] if field == "position" else 0.0
            rows[f"base.{field}.{axis}"] = value + shift
        for field in ("angular_velocity", "angular_acceleration"):
            rows[f"base.{field}.{axis}"] = 0.0 * t
    for axis, value in zip("xyzw", (0, 0, 0, 1), strict=True):
        rows[f"base.orientation.{axis}"] = value + 0.0 * t
    names = ["time", *list(rows)[:: -1 if reverse else 1]]
    rows["time"] = t
    return table((name, rows[name]) for name in names)


def table(columns):
    return Result({"samples": Table([Column(name, values) for name, values in columns])})


def force(samples, side):
    return np.column_stack([samples[f"{side}_sole.force_{axis}"] for axis in "xyz"])


def residual(samples):
    words = [f"{kind}_{axis}" for kind in ("force", "torque") for axis in "xyz"]
    return np.column_stack([samples[f"base.residual.{word}"] for word in words])


def loaded(samples):
    """Force of the ground that the motion of the masses asks for, in closed form, shape (n, 3)."""
    a = np.zeros((len(samples["time"]), 3))
    for axis in "xyz":
        i, total = "xyz".index(axis), samples[f"base.linear_acceleration.{axis}"]
        a[:, i] += 30.0 * total
        for side in SIDES:
            for k, mass in enumerate((1.0, 1.0, 2.0)):
                moved = [f"{side}_{one}" for one in "xyz"[: k + 1] if one == axis]
                own = sum((samples[f"{name}.acceleration"] for name in moved), 0.0 * total)
                a[:, i] += mass * (total + own)
    a[:, 2] += 38.0 * G
    return a


@pytest.mark.parametrize("method", ["minimum-norm", "smooth"])
def test_two_feet_carry_what_the_motion_asks_for(method):
    """All of the force; 100 m away and with columns in reverse the same; nothing is left."""
    found = biped().inverse(sway(), stance=method, power=True)
    here = found["samples"]
    away = (100.0, -50.0, 20.0)
    there = biped(away).inverse(sway(away, reverse=True), stance=method, power=True)["samples"]
    total = force(here, "left") + force(here, "right")
    assert total == pytest.approx(loaded(here), abs=1e-8)
    for samples in (here, there):
        assert np.abs(residual(samples)).max() <= 1e-9
        assert np.abs(samples["power.residual"]).max() <= 1e-9
    for name in (*(f"{one}.effort" for one in JOINTS), "left_sole.force_z"):
        assert there[name] == pytest.approx(here[name], abs=1e-4)  # 1e-6 of what was weighed
    alone = ~((here["time"] > 0.35) & (here["time"] < 0.85))
    assert there["left_z.effort"][alone] == pytest.approx(here["left_z.effort"][alone], abs=1e-9)
    for side in SIDES:
        for i in range(4):
            normal, *friction = (
                here[f"{side}_sole.point_{i}_{row}"]
                for row in ("normal", "friction_x", "friction_y")
            )
            assert (np.hypot(*friction) <= 0.7 * normal + 1e-6).all()
            assert normal.min() >= -1e-6
    assert any("both or more 38%" in text for text in found.metadata["remarks"])


def test_efforts_are_the_smallest_where_the_motion_leaves_them_open():
    """In the middle both feet share alike; no push of one foot against the other is smaller."""
    samples = biped().inverse(sway(), stance="minimum-norm")["samples"]
    both = np.flatnonzero((samples["time"] > 0.5) & (samples["time"] < 0.7))
    u = np.column_stack([samples[f"{name}.effort"] for name in JOINTS])[both]
    for axis in range(3):  # no limit acts there: the efforts are across what the feet exchange
        exchange = np.zeros(6)
        exchange[[axis, 3 + axis]] = 1.0, -1.0
        assert np.abs(u.dot(exchange)[len(both) // 2]) <= 1e-9
    assert force(samples, "left")[30, 2] == pytest.approx(38.0 * G / 2.0, abs=1e-9)


def test_a_smooth_transition_keeps_the_shares_of_walking():
    """Ren 2008: exp(-(2 t / T)^3) of what the trailing foot bore, across and up."""
    found = biped().inverse(sway(), stance="smooth")
    samples = found["samples"]
    kept = force(samples, "left")
    (said,) = [text for text in found.metadata["remarks"] if "smooth" in text]
    assert "smooth transition in 1 double supports, else" in said
    middle = slice(25, 31)  # before and after it the places of the feet allow other shares only
    share = (samples["time"][middle] - samples["time"][18]) / (samples["time"][42] - 0.36)
    decay = np.exp(-((2.0 * share) ** 3))
    assert kept[middle, 2] == pytest.approx(kept[18, 2] * decay, abs=0.01)
    way = samples["base.position.y"][41] - samples["base.position.y"][18]
    along = np.array([0.1 * 0.46, way, 0.0]) / np.hypot(0.1 * 0.46, way)
    assert abs(kept[middle].dot(along)).max() > 10.0  # most of the way is to the side


def test_a_plate_below_one_foot_leaves_nothing_open():
    """Its force is that of another split; then the other foot and all efforts follow exactly."""
    smooth = biped().inverse(sway(), stance="smooth")["samples"]
    plate = [("time", smooth["time"])]
    for kind, name in (("force", "force"), ("torque", "torque"), ("point", "centre_of_pressure")):
        plate += [(f"plate.{kind}.{axis}", smooth[f"left_sole.{name}_{axis}"]) for axis in "xyz"]
    measured = {"plate": {"frame": "left_foot", "expressed_in": "world"}}
    scene = biped(external_wrenches=measured)
    found = scene.inverse(sway(), stance="minimum-norm", wrenches=table(plate))
    samples = found["samples"]
    for joint_name in JOINTS:
        expected = smooth[f"{joint_name}.effort"]
        assert samples[f"{joint_name}.effort"] == pytest.approx(expected, abs=1e-8)
    assert force(samples, "right") == pytest.approx(force(smooth, "right"), abs=1e-8)
    assert "stance: forces of left_sole are measured" in found.metadata["remarks"]
    assert np.abs(residual(samples)).max() <= 1e-8


def test_a_foot_that_cannot_bear_the_motion_leaves_a_residual():
    """The trunk is beside the only foot, whose corners never pull: the base says what lacks."""
    found = biped(sides=["left"]).inverse(sway(), stance="minimum-norm", power=True)
    samples = found["samples"]
    assert samples["left_sole.force_z"].min() >= 0.0
    last = np.linalg.norm(residual(samples)[-1])
    assert np.abs(residual(samples)[:15]).max() <= 1e-9 and last > 100.0
    assert np.abs(samples["power.residual"]).max() <= 1e-8
    (said,) = [text for text in found.metadata["remarks"] if "residual of the base" in text]
    assert said.endswith("the weight is 372.8 N")


def test_states_of_contacts_decide_where_the_motion_has_them():
    motion = sway()
    given = [(column.name, column.values) for column in motion["samples"].columns]
    on = np.where(motion["samples"]["time"] < 0.59, 2.0, 0.0)
    for side, state in (("left", on), ("right", 2.0 - on)):
        given += [(f"{side}_sole.state_point_{i}", state) for i in range(4)]
    found = biped().inverse(table(given), stance="minimum-norm")
    assert (force(found["samples"], "left")[:30, 2] > 300.0).all()
    assert (force(found["samples"], "left")[30:] == 0.0).all()
    assert any("stance: by columns of states" in text for text in found.metadata["remarks"])
    lacking = table(pair for pair in given if pair[0] != "left_sole.state_point_3")
    with pytest.raises(DataError, match=r"no column left_sole.state_point_3.*, or it has gaps"):
        biped().inverse(lacking, stance="minimum-norm")


def drives(times):
    """Efforts of knee and ankle."""
    efforts = ("knee", 15.0 * np.sin(20.0 * times)), ("ankle", -10.0 + 30.0 * times)
    return table([("time", times), *((f"{name}.effort", u) for name, u in efforts)])


def test_a_prosthetic_leg_gives_its_drive_torques_back():
    """From the heel to the whole foot: with the forces of the ground and without them."""
    scene = mbd.load_scene("prosthetic_leg_roll_over")
    run = scene.simulate(0.16, dt=0.002, efforts=drives(np.linspace(0.0, 0.2, 101)))
    samples = run["samples"]
    assert {0.0, 2.0} <= set(samples["toe.state"]) and samples["heel.state"][-1] > 0.0
    motion = [c for c in samples.columns if not c.name.startswith(("heel.", "toe."))]
    alone = Result({"samples": Table(motion)})
    for found in (scene.inverse(run, power=True), scene.inverse(alone, stance="minimum-norm")):
        for name in ("knee", "ankle"):
            given = samples[f"{name}.effort"]
            assert np.ptp(given) > 1.0
            assert found["samples"][f"{name}.effort"] == pytest.approx(given, abs=1e-8)
        assert np.abs(residual(found["samples"])).max() <= 1e-8
    foot = samples["heel.force_z"] + samples["toe.force_z"]
    free = found["samples"]["heel.force_z"] + found["samples"]["toe.force_z"]
    assert free == pytest.approx(foot, abs=1e-8) and foot.max() > 400.0


def four_bar_on_foot():
    """The leg with a four-bar knee flies free and comes onto its sole; two drives move it."""
    leg = mbd.load_scene("four_bar_leg")
    urdf_file = str(leg.path.parents[1] / "robots/four_bar_leg.urdf")
    bent = {name: q for name, q in leg.entries["initial"]["position"].items() if "knee" in name}
    sections = {
        "robot": {"urdf": urdf_file, "base": "floating", "locked": {"hip_flexion": 0.0}},
        "constraints": leg.entries["constraints"],
        "forces": leg.entries["forces"],
        "actuators": [{"type": "ideal", "joints": [one]} for one in ("knee_anterior", "ankle")],
        "initial": {"position": bent},
        "integrator": {"type": "moreau_jean"},
    }
    sole = [[x, y, -0.06825] for x in (-0.0665, 0.1995) for y in (0.035, -0.035)]
    ground = {"half_space": [0.0, 0.0, 1.0], "xyz": [0.0, 0.0, -0.0055]}
    entry = {"type": "rigid", "name": "sole", "friction": 0.7}
    entry["between"] = [{"frame": "foot", "points": sole}, ground]
    return mbd.scene_from(sections | {"contacts": [entry]})


@pytest.mark.parametrize("bounds", [False, True])
def test_a_leg_with_a_loop_in_its_knee_gives_its_drive_torques_back(bounds):
    scene, t = four_bar_on_foot(), np.linspace(0.0, 0.2, 101)
    efforts = [
        ("knee_anterior.effort", 5.0 * np.sin(30.0 * t)),
        ("ankle.effort", np.cos(20.0 * t)),
    ]
    run = scene.simulate(0.07, dt=0.002, efforts=table([("time", t), *efforts]))
    samples = run["samples"]
    assert samples["sole.force_z"][0] == 0.0 and samples["sole.force_z"][-1] > 20.0
    motion = Result({"samples": Table([c for c in samples.columns if "sole." not in c.name])})
    found = scene.inverse(motion, stance="minimum-norm", power=True, bounds=bounds)["samples"]
    for name in ("knee_anterior", "ankle"):
        assert found[f"{name}.effort"] == pytest.approx(samples[f"{name}.effort"], abs=1e-8)
    assert np.abs(residual(found)).max() <= 1e-9
    assert np.abs(found["power.residual"]).max() <= 1e-9


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"stance": "best"}, "--stance best: accepted: minimum-norm, smooth"),
        ({"stance_gap": 0.1}, "--stance-gap is accepted together with --stance"),
        ({"stance": "smooth", "stance_speed": -1.0}, "--stance-speed -1 must be >= 0 and finite"),
        ({"stance": "smooth", "stance_gap": math.nan}, "--stance-gap nan must be >= 0 and finite"),
        ({"stance": "smooth", "parts": True}, "--parts is accepted only for scenes without loops"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message):
    with pytest.raises(DataError, match=message):
        biped().inverse(sway(), **options)
    with pytest.raises(DataError, match="--stance needs a scene with rigid contacts"):
        biped(contacts=None).inverse(sway(), stance="smooth")


@pytest.fixture(scope="module")
def person():
    """A walking person, 72.6 kg, on the soles of both feet, and what plates measured."""
    folder = RECORDINGS / "gait10dof/walk"
    walk = mbd.load_scene(folder / "scene.yaml")
    sole = [[x, -0.01, z] for x in (-0.02, 0.2) for z in (0.03, -0.03)]
    floor = {"half_space": [0.0, 1.0, 0.0], "xyz": [0.0, 0.033, 0.0]}
    feet = [
        {
            "type": "rigid",
            "name": f"foot_{side}",
            "between": [{"frame": f"calcn_{side}", "points": sole}, floor],
            "friction": 0.8,
        }
        for side in "rl"
    ]
    plates = read_result(folder / "external_wrenches.csv.gz")["samples"]
    pushed = {"r": plates["right.force.y"], "l": plates["left.force.y"]}
    scene = walk.with_(contacts=feet, external_wrenches=None)
    return scene, read_result(folder / "motion.csv.gz"), pushed


def root_mean_square(values):
    return np.sqrt(np.mean(values**2))


def test_feet_of_a_person_carry_what_plates_measured(person):
    """The pelvis slides on joints without drives, so that these stand for a base.

    Plates themselves leave up to 167 N there, of a weight of 712 N.
    """
    scene, motion, pushed = person
    options = {"stance": "minimum-norm", "stance_gap": 0.013, "stance_speed": 0.1}
    found = scene.inverse(motion, power=True, **options)["samples"]
    both = found["foot_r.force_y"] + found["foot_l.force_y"]
    assert root_mean_square(both - pushed["r"] - pushed["l"]) <= 0.06 * 712.0
    assert "pelvis_ty.residual" in found and "pelvis_ty.effort" not in found
    assert np.abs(found["power.residual"]).max() <= 1e-9


def test_the_smooth_transition_is_nearer_to_plates_than_the_least_efforts(person):
    """Feet stand where their plates say so; double supports at the ends are cut off."""
    scene, motion, pushed = person
    on = {side: force > 20.0 for side, force in pushed.items()}
    columns = [(c.name, c.values) for c in motion["samples"].columns]
    for side, stands in on.items():
        columns += [(f"foot_{side}.state_point_{i}", 2.0 * stands) for i in range(4)]
    times, double = motion["samples"]["time"], on["r"] & on["l"]
    inner = double & (times > 0.2) & (times < 2.4)
    off = {}
    for method in ("minimum-norm", "smooth"):
        found = scene.inverse(table(columns), stance=method)["samples"]
        misses = [found[f"foot_{side}.force_y"] - pushed[side] for side in "rl"]
        assert all(root_mean_square(miss[~double]) <= 20.0 for miss in misses)
        off[method] = root_mean_square(np.concatenate([miss[inner] for miss in misses]))
    assert off["smooth"] <= 80.0 and off["smooth"] <= 0.7 * off["minimum-norm"]


def test_the_force_of_the_trailing_foot_ends_with_the_double_support():
    way, force_then = np.array([1.0, 0.0, 0.0]), np.array([50.0, 20.0, 600.0])
    assert trailing_force(force_then, way, 0.0) == pytest.approx(force_then, abs=1e-12)
    end = trailing_force(force_then, way, 1.0)
    assert end == pytest.approx([0.0, 20.0 * np.exp(-8), 600.0 * np.exp(-8)], abs=1e-12)
    half = trailing_force(force_then, way, 0.5)
    shares = np.exp(4 / 9 - 1 / 9) - np.exp(-4 / 3) / 2, np.exp(-1)
    assert half / force_then == pytest.approx([shares[0], shares[1], shares[1]], abs=1e-12)


@pytest.mark.parametrize("decides", ["phases", "columns of states"])
def test_a_passive_walker_needs_no_drive_on_the_foot_of_its_phase(decides):
    """Its hips are free, its travel and height stand for a base: nothing is needed, 1e-12."""
    walker = mbd.load_scene("simplest_walker")
    run = walker.simulate(4.5)
    samples = run["samples"]
    assert set(samples["phase"]) == {0.0, 1.0}
    feet = ("left_foot", "right_foot")
    lost = ["force", "friction", "normal", "torque", "centre"]
    lost += ["state"] if decides == "phases" else []

    def is_kept(name):
        return not (name.startswith(feet) and name.partition(".")[2].startswith(tuple(lost)))

    kept = [(c.name, c.values) for c in samples.columns if is_kept(c.name)]
    found = walker.inverse(table(kept), stance="minimum-norm", power=True)
    alone = found["samples"]
    assert any(f"stance: by {decides};" in text for text in found.metadata["remarks"])
    for name in ("left_hip.effort", "right_hip.effort", "travel.residual", "height.residual"):
        assert np.abs(alone[name]).max() <= 1e-12
    for foot in feet:
        assert alone[f"{foot}.normal"] == pytest.approx(samples[f"{foot}.normal"], abs=1e-12)
    assert np.abs(alone["power.residual"]).max() <= 1e-12
    if decides == "phases":
        given = [(n, 7.0 + 0.0 * v if n == "phase" else v) for n, v in kept]
        with pytest.raises(DataError, match="the scene has no phase 7; accepted: 0 to 1: left_"):
            walker.inverse(table(given), stance="smooth")
