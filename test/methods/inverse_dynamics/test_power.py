"""Powers of joints, parts and segments, and their balance."""

import numpy as np
import pytest
from mechanisms import joint, link, urdf
from places import RECORDINGS
from scipy.interpolate import CubicSpline

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.files.power_flow import lanes_of
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.files.tables.csv import read_table

SUMS = ("efforts", "couplings", "constraints", "contacts", "forces", "external_wrenches")
SUMS += ("gravity", "unexplained")


def columns(path):
    table = read_table(path)
    return dict(zip(table.columns, table.values.T, strict=True))


def balance(samples):
    """Largest residual, recomputed from the columns, and the largest sum."""
    sums = np.array([samples[f"power.{name}"] for name in SUMS])
    rate = samples["power.kinetic_energy_rate"]
    assert samples["power.residual"] == pytest.approx(sums.sum(axis=0) - rate, abs=1e-9)
    return np.abs(samples["power.residual"]).max(), max(np.abs(sums).max(), np.abs(rate).max())


def ends(samples, link):
    """What the joint of a link gives to it and to the link before."""
    given = [name for name in samples if name.endswith(f".distal_power_{link}")]
    return samples[f"{link}.proximal_power"] + sum(samples[name] for name in given)


def segments_balance(samples):
    """Largest difference of what goes into a segment and the rate of its kinetic energy."""
    off = []
    for name in samples:
        segment, _, quantity = name.partition(".")
        if quantity == "kinetic_energy_rate" and segment != "power":
            going_in = [
                samples[other]
                for other in samples
                if other.startswith(f"{segment}.") and "power" in other
            ]
            off.append(np.abs(sum(going_in) - samples[name]).max())
    assert off
    return max(off)


def without_efforts(result):
    kept = [c for c in result["samples"].columns if not c.name.endswith((".effort", ".command"))]
    return Result({"samples": Table(kept)})


@pytest.fixture(scope="module")
def walk():
    folder = RECORDINGS / "gait10dof/walk"
    found = mbd.load_scene(folder / "scene.yaml").inverse(
        folder / "motion.csv.gz", wrenches=folder / "external_wrenches.csv.gz", power=True
    )
    return found["samples"], columns(folder / "reference_torques.csv.gz")


def test_powers_of_walking_balance(walk):
    """Rates of the kinetic energy also by a spline through it, which sees none of the forces."""
    samples, _ = walk
    off, largest = balance(samples)
    assert largest > 200.0 and off <= 1e-9
    energy = CubicSpline(samples["time"], samples["power.kinetic_energy"])(samples["time"], 1)
    inside = slice(3, -3)  # a natural cubic is worse at its ends
    error = energy[inside] - samples["power.kinetic_energy_rate"][inside]
    assert np.sqrt(np.mean(error**2)) <= 1e-2 * np.sqrt(np.mean(energy[inside] ** 2))


def test_powers_of_joints_are_those_of_the_reference(walk):
    """To the accuracy of the torques: 0.0045 % of their rms, here 0.02 % of the power's."""
    samples, reference = walk
    for side in "rl":
        for name in ("hip_flexion", "knee_angle", "ankle_angle"):
            joint = f"{name}_{side}"
            expected = reference[f"{joint}.effort"] * samples[f"{joint}.velocity"]
            off = np.abs(samples[f"{joint}.power"] - expected).max()
            assert off <= 2e-4 * np.abs(expected).max()


def test_power_through_segments_of_a_walking_person(walk):
    """Hip, knee and ankle: both ends of a joint together are its power, slides of the knee too."""
    samples, _ = walk
    assert segments_balance(samples) <= 1e-10
    for side in "rl":
        pairs = (("femur", "hip_flexion"), ("tibia", "knee_angle"), ("calcn", "ankle_angle"))
        for link_name, joint_name in pairs:
            power = samples[f"{joint_name}_{side}.power"]
            assert ends(samples, f"{link_name}_{side}") == pytest.approx(power, abs=1e-10)
        through = np.abs(samples[f"femur_{side}.proximal_power"])
        assert through.max() > np.abs(samples[f"hip_flexion_{side}.power"]).max()


LEG = urdf(
    *(link("trunk", 8.0, (0.0, 0.02, 0.2), (0.3, 0.2, 0.1)), link("carriage")),
    *(link("thigh", 3.0, (0.01, 0.0, -0.2), (0.05, 0.05, 0.01)), link("shank", 2.0, (0, 0, -0.2))),
    joint("hip", "revolute", "trunk", "carriage", (0, 1, 0), (0.0, 0.1, 0.0)),
    joint("slide", "prismatic", "carriage", "thigh", (0, 0, 1)),
    joint("knee", "revolute", "thigh", "shank", (0.1, 1, 0), (0.0, 0.0, -0.4)),
)


def flying(away=(0.0, 0.0, 0.0), order=1):
    """A free leg with a coupled slide, a spring and a load, that turns and moves far away."""
    scene = mbd.scene_from(
        {
            "robot": {"base": "floating"},
            "couplings": {"slide": {"parent": "knee", "polynomial": [0.0, 0.05, 0.02]}},
            "forces": [
                {"type": "joint_spring", "joint": "knee", "stiffness": 20.0, "damping": 0.7},
                {"type": "applied_wrench", "frame": "shank", "force": [3.0, -2.0, 5.0]},
            ],
        },
        urdf=LEG,
    )
    t = np.linspace(0.0, 1.0, 41)
    w, rows = np.array([3.0, 4.0]), {"time": t}
    for name, speed in zip(("hip", "knee"), w, strict=True):
        values = 0.5 * np.sin(speed * t), 0.5 * speed * np.cos(speed * t)
        values = (*values, -0.5 * speed**2 * np.sin(speed * t))
        for field, value in zip(("position", "velocity", "acceleration"), values, strict=True):
            rows[f"{name}.{field}"] = value
    spin = 1.3  # about z, while it moves on a circle: body axes see a constant velocity
    for axis, value in zip("xyz", (np.cos(spin * t), np.sin(spin * t), 0.3 * t), strict=True):
        rows[f"base.position.{axis}"] = value + away["xyz".index(axis)]
    half = spin * t / 2.0
    for axis, value in zip("xyzw", (0 * t, 0 * t, np.sin(half), np.cos(half)), strict=True):
        rows[f"base.orientation.{axis}"] = value
    fields = ("linear_velocity", (0, spin, 0.3)), ("angular_velocity", (0, 0, spin))
    fields += ("linear_acceleration", (0, 0, 0)), ("angular_acceleration", (0, 0, 0))
    for field, values in fields:
        for axis, value in zip("xyz", values, strict=True):
            rows[f"base.{field}.{axis}"] = np.full_like(t, value)
    names = ["time", *list(rows)[1:][::order]]
    motion = Result({"samples": Table([Column(name, rows[name]) for name in names])})
    return scene.inverse(motion, power=True)["samples"]


def test_power_of_a_free_leg_does_not_know_where_it_is():
    """100 m away and with its columns in reverse; powers of parts by their closed forms."""
    here, there = flying(), flying((100.0, -50.0, 20.0), -1)
    assert balance(here)[1] > 10.0
    for samples in (here, there):
        assert balance(samples)[0] <= 1e-10
        assert segments_balance(samples) <= 1e-10
    for name in here:
        if "power" in name:
            assert there[name] == pytest.approx(here[name], abs=1e-9)
    q, v = here["knee.position"], here["knee.velocity"]
    assert here["knee_joint_spring.power"] == pytest.approx(-(20.0 * q + 0.7 * v) * v, abs=1e-12)
    within = ends(here, "thigh"), here["hip.power"] + here["slide.coupling_power"]
    assert within[0] == pytest.approx(within[1], abs=1e-10)  # its coupling works on the knee
    assert np.abs(here["slide.coupling_power"]).max() > 0.1
    whole = here["power.kinetic_energy_rate"]
    spline = CubicSpline(here["time"], here["power.kinetic_energy"])(here["time"], 1)
    assert whole[3:-3] == pytest.approx(spline[3:-3], abs=2e-3 * np.abs(whole).max())


def test_powers_of_a_bare_leg_balance():
    """Nothing acts but efforts and the weight, which stand alone in their sums."""
    leg, t = mbd.load_scene("prosthetic_leg"), np.linspace(0.0, 1.0, 21)
    rows = [("time", t)]
    for i, name in enumerate(leg.couplings.independent):
        w = 3.0 + i
        rows.append((f"{name}.position", 0.2 * np.sin(w * t) - 0.4 * (name == "knee")))
        rows.append((f"{name}.velocity", 0.2 * w * np.cos(w * t)))
        rows.append((f"{name}.acceleration", -0.2 * w**2 * np.sin(w * t)))
    motion = Result({"samples": Table([Column(*row) for row in rows])})
    samples = leg.inverse(motion, power=True)["samples"]
    off, largest = balance(samples)
    assert off <= 1e-12 * largest
    assert segments_balance(samples) <= 1e-11
    both = samples["power.efforts"] + samples["power.gravity"]
    assert both == pytest.approx(samples["power.kinetic_energy_rate"], abs=1e-11)


@pytest.mark.parametrize("bounds", [False, True])
def test_power_of_a_four_bar_knee(bounds):
    """The damper of a passive leg takes what its energy loses; the loop does no work."""
    leg = mbd.load_scene("four_bar_leg")
    run = leg.simulate(0.1, integrator="rk4", dt=0.002)
    samples = leg.inverse(without_efforts(run), power=True, bounds=bounds)["samples"]
    off, largest = balance(samples)
    assert off <= 1e-9 * largest
    assert np.abs(samples["power.constraints"]).max() <= 1e-9
    assert segments_balance(samples) <= 1e-9
    damped = -0.5 * samples["knee_posterior.velocity"] ** 2
    assert samples["knee_posterior_joint_spring.power"] == pytest.approx(damped, abs=1e-12)
    closures = np.abs(samples["shank.load_power"]).max()  # what the posterior bar gives to it
    assert closures > 0.1


def test_power_of_contacts_and_drives():
    """A ball that slides loses what friction takes; a drive gives what gravity takes."""
    ground = {"half_space": [0.1, 0.0, 1.0]}
    ball = mbd.scene_from(
        {
            "bodies": {"ball": {"shape": {"sphere": 0.1}, "mass": 2.0}},
            "contacts": [{"type": "rigid", "between": ["ball", ground], "friction": 0.3}],
            "initial": {
                "pose": {"ball": {"xyz": [0.0, 0.0, 0.3]}},
                "twist": {"ball": {"linear": [4.0, 1.0, 0.0]}},
            },
            "dt": 0.01,
        }
    )
    found = ball.inverse(ball.simulate(0.4), power=True)["samples"]
    assert balance(found)[0] <= 1e-9
    assert found["power.contacts"].min() < -10.0
    assert np.array_equal(found["ball_contact_on_ball.power"], found["power.contacts"])
    lift = urdf(
        link("world"), link("car", 3.0), joint("z", "prismatic", "world", "car", (0, 0, 1))
    )
    moved = {"type": "prescribed_motion", "joint": "z", "polynomial": [0.0, 0.5, 0.2]}
    lifted = mbd.scene_from({"constraints": [moved], "dt": 0.01}, urdf=lift)
    found = lifted.inverse(lifted.simulate(0.3), power=True)["samples"]
    assert balance(found)[0] <= 1e-10
    expected = 3.0 * (9.81 + 0.4) * found["z.velocity"]
    assert found["power.efforts"] == pytest.approx(expected, abs=1e-9)


def test_bands_show_what_goes_through_the_thigh(tmp_path, capsys):
    """The picture of a walking person; a result without powers is refused by name."""
    folder = RECORDINGS / "gait10dof/walk"
    motion, out = folder / "motion.csv.gz", tmp_path / "walk.csv"
    loads = ["--wrenches", str(folder / "external_wrenches.csv.gz")]
    words = ["inverse", str(folder / "scene.yaml"), str(motion), *loads, "-o", str(out), "--power"]
    assert main(words) == 0
    drawn = tmp_path / "flow.svg"
    assert main(["plot", str(out), "-o", str(drawn), "--power-flow"]) == 0
    text = drawn.read_text()
    assert text.count("<path") > 60 and "kinetic" not in text
    table = mbd.read_result(out)["samples"]
    lanes = {lane.text: lane.power for lane in lanes_of(table)}
    assert len(lanes) == 1 + 3 * 7
    thigh = lanes["into femur_r"], lanes["femur_r to the joint of tibia_r"]
    assert np.corrcoef(*thigh)[0, 1] > 0.9  # what comes in goes out, but for its own energy
    knee = table["knee_angle_r.power"]
    assert lanes["joint of tibia_r"] == pytest.approx(knee, abs=1e-10)
    assert main(["plot", str(motion), "-o", str(drawn), "--power-flow"]) == 2
    assert "no column *.proximal_power" in capsys.readouterr().err
    assert main(["plot", str(out), "-o", str(drawn), "--power-flow", "--columns", "effort"]) == 2
