"""Identification of drives: motors that turn with two joints, and feedback of measured noise."""

import numpy as np
import pinocchio as pin
import pytest
from identification_data import fourier, moved, others, recording

from mbd_ros.api import scene_from
from mbd_ros.cli import main
from mbd_ros.errors import DataError
from mbd_ros.features.identification.job import identify

pytest.importorskip("clarabel", reason="clarabel is optional (extra: identification)")
WAYS = {
    "one motor also by the other joint": ([[1.0, 0.0], [1.0, 1.0]], True),
    "behind bevel gears": ([[1.0, 1.0], [-1.0, 1.0]], False),
}


def wrist(ratios, are_motors):
    """A bare arm, one that rubs at motors of its joints 5 and 6, and a recording of it."""
    bare, t = scene_from({}, urdf="arm7"), np.arange(0.0, 15.0, 0.02)
    names, U = bare.couplings.independent, np.eye(7)
    U[4:6, 4:6] = ratios
    rubbing = [
        {"type": "gear_friction", "joint": n, "coulomb": 1.0, "viscous": 0.4, "smoothing": 0.02}
        for n in names
    ]
    for row, other in ((4, 5), (5, 4)):
        if U[row, other]:
            rubbing[row]["also"] = {names[other]: float(U[row, other])}
    true = others(bare).with_(forces=rubbing)
    q, v, a = fourier(7, t, 1, amplitude=0.4)
    tau = true.inverse_dynamics().batch(q, v, a, []).tau
    if are_motors:
        tau = tau @ np.linalg.inv(U)
    tau += 0.02 * np.random.default_rng(1).normal(size=tau.shape)
    return bare, true, recording(names, t, position=q, velocity=v, acceleration=a, effort=tau)


@pytest.mark.parametrize("way", WAYS)
def test_motors_that_two_joints_turn_are_found_by_their_friction(way):
    ratios, are_motors = WAYS[way]
    bare, true, data = wrist(ratios, are_motors)
    found = identify(bare, data)
    entries = {entry["joint"]: entry for entry in found.scene.entries["forces"]}
    for entry in true.entries["forces"][4:6]:
        own = entries[entry["joint"]]
        assert own.get("also", {}) == entry.get("also", {})
        assert own["coulomb"] == pytest.approx(1.0, abs=0.05)
        assert own["viscous"] == pytest.approx(0.4, abs=0.05)
    assert any("efforts are those of the motors" in line for line in found.remarks) == are_motors
    assert found.errors["identified"] < 2e-3 < 0.1 < found.errors["given"]


def test_motors_are_coupled_as_the_scene_says():
    """The ratios that the scene gives are kept, whatever they are; here one that is no whole."""
    bare, true, data = wrist([[1.0, 0.0], [0.3, 1.0]], True)
    found = identify(true, data)
    (entry,) = (e for e in found.scene.entries["forces"] if "also" in e)
    assert entry["also"] == {bare.couplings.independent[4]: 0.3}
    assert entry["coulomb"] == pytest.approx(1.0, abs=0.05)
    assert found.errors["identified"] < 2e-3


def test_what_a_drive_answers_to_noise_of_its_velocity_is_told():
    """A damping controller of 20 N·m·s/rad on one joint; its torque moves nothing here."""
    scene, t = scene_from({}, urdf="arm7"), np.arange(0.0, 12.0, 0.01)
    q, v, a = fourier(7, t, 1, amplitude=0.4)
    random = np.random.default_rng(2)
    jitter, sensor = random.normal(0.0, 0.02, v.shape), random.normal(0.0, 0.2, v.shape)
    gains = np.array([0.0, 20.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    tau = scene.inverse_dynamics().batch(q, v, a, []).tau - gains * jitter + sensor
    names = scene.couplings.independent
    found = identify(scene, recording(names, t, position=q, velocity=v + jitter, effort=tau))
    drives = found.tables["drives"]
    assert drives["feedback"] == pytest.approx(gains, abs=1.0)
    assert (drives["feedback"] > 0.0).sum() == 1
    errors = found.errors
    assert errors["identified as measured"] < 0.95 * errors["identified without feedback"]


GAINS = np.array([20.0, 25.0, -18.0, 15.0, 8.0, 7.0, 5.0])  # N·m/A
LOAD = pin.Inertia(3.0, np.array([0.02, 0.01, 0.1]), 0.01 * np.eye(3))


def currents(scene, seed, ratios=None):
    """Motor currents of a scene on a random motion, with noise."""
    t = np.arange(0.0, 12.0, 0.01)
    q, v, a = fourier(7, t, seed, amplitude=0.4)
    tau = scene.inverse_dynamics().batch(q, v, a, []).tau
    tau += 0.02 * np.random.default_rng(seed).normal(size=tau.shape)
    names = scene.couplings.independent
    tau = tau if ratios is None else tau @ np.linalg.inv(ratios)
    return recording(names, t, position=q, velocity=v, acceleration=a, effort=tau / GAINS)


@pytest.mark.parametrize("fixed_by", ["load", "links", "nothing"])
def test_gains_of_currents_are_found_where_something_fixes_the_scale(fixed_by):
    bare = scene_from({}, urdf="arm7")
    names, true = bare.couplings.independent, others(bare)
    inertias = true.robot.inertias()
    heavier = inertias["link7"] + LOAD
    data = currents(true, 1)
    more = {
        "nothing": {},
        "load": {"held": currents(true.with_inertias({"link7": heavier}), 2)},
        "links": {"known": ["link6", "link7"]},
    }[fixed_by]
    if fixed_by == "load":
        more["payload"] = ("link7", [3.0, 0.02, 0.01, 0.1, 0.01, 0.01, 0.01])
    scene = bare.with_inertias({name: inertias[name] for name in more.get("known", ())})
    if fixed_by == "nothing":
        with pytest.raises(DataError, match=f"determines the gains of {', '.join(names)}.*--held"):
            identify(scene, data, currents=True)
        return
    found = identify(scene, data, currents=True, **more)
    drives = found.tables["drives"]
    assert drives["gain"] == pytest.approx(GAINS, rel=0.01 if fixed_by == "load" else 0.1)
    assert np.all(np.abs(drives["gain"] - GAINS) < 4.0 * drives["gain_deviation"])
    assert found.errors["identified"] < 5e-3


@pytest.mark.soak
def test_gains_of_motors_that_two_joints_turn_are_found_with_a_load():
    bare, true, _ = wrist(WAYS["behind bevel gears"][0], True)
    U = np.eye(7)
    U[4:6, 4:6] = WAYS["behind bevel gears"][0]
    known = [{**entry, "coulomb": 0.1} for entry in true.entries["forces"] if "also" in entry]
    laden = true.with_inertias({"link7": true.robot.inertias()["link7"] + LOAD})
    found = identify(
        bare.with_(forces=known),
        currents(true, 1, U),
        held=currents(laden, 2, U),
        payload=("link7", [3.0, 0.02, 0.01, 0.1, 0.01, 0.01, 0.01]),
        currents=True,
    )
    assert found.tables["drives"]["gain"] == pytest.approx(GAINS, rel=0.03)
    assert found.errors["identified"] < 5e-3


@pytest.mark.soak
def test_a_known_load_is_no_part_of_the_robot():
    """Torques with and without a load of 3 kg that is said: bodies are those without it."""
    bare, t = scene_from({}, urdf="arm7"), np.arange(0.0, 12.0, 0.01)
    true = others(bare)
    laden = true.with_inertias({"link7": true.robot.inertias()["link7"] + LOAD})
    load = ("link7", [3.0, 0.02, 0.01, 0.1, 0.01, 0.01, 0.01])
    found = identify(bare, moved(bare, true, t), held=moved(bare, laden, t, seed=2), payload=load)
    table = found.tables["base_parameters"]
    expected = identify(true, moved(bare, true, t)).tables["base_parameters"]["given"]
    assert np.abs(table["estimate"] - expected).max() < 1e-8
    assert found.errors["identified"] < 1e-4


BAD = {
    "--held": (["--held", "{motion}"], "--held and --payload"),
    "--payload": (["--held", "{motion}", "--payload", "elbow=2,0,0,0"], "--payload elbow"),
    "mass": (["--held", "{motion}", "--payload", "flange=-2,0,0,0"], "expected LINK=MASS"),
    "--known": (["--known", "elbow"], "--known elbow: no link that moves; accepted are link1"),
}


@pytest.mark.parametrize("case", BAD)
def test_words_about_what_is_known_are_checked(tmp_path, capsys, case):
    words, said = BAD[case]
    motion, out = str(tmp_path / "motion.csv"), tmp_path / "out"
    currents(scene_from({}, urdf="arm7"), 1).to(motion)
    every = ["identify", "arm7", motion, "-o", str(out)]
    assert main([*every, *(word.format(motion=motion) for word in words)]) == 2
    assert said in capsys.readouterr().err
    assert not out.exists()
