"""What the commands find reads back equal from every format that can hold it."""

import os
import signal
import threading

import numpy as np
import pytest
from places import ROOT

from mbd_ros.cli import main
from mbd_ros.core.state import Motion
from mbd_ros.errors import DataError
from mbd_ros.features.inverse_dynamics.job import inverse
from mbd_ros.features.replay.job import TorqueErrors
from mbd_ros.features.simulation.job import Interrupted, simulate
from mbd_ros.files.formats import suffix_of
from mbd_ros.files.table import Result, read_result, rounded, stamps_of
from mbd_ros.scene.reader import load_scene

SCENES = ROOT / "config/scenes"
STOPS = "constraints:\n- {type: joint_stop, joint: hinge, lower: -0.1, upper: 0.1}\n"
STIFF = (
    "forces: [{type: joint_spring, joint: hinge, stiffness: 1.0e+7}]\n"
    "integrator: {type: semi_implicit_euler}\ndt: 0.01\ninitial: {position: {hinge: 0.1}}\n"
)
NAMES = ("o.csv", "o.csv.gz", "o.npz", "o.parquet", "bag", "o.mcap", "o.db3")


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    """A scene of the pendulum with more sections."""
    folder = tmp_path_factory.mktemp("scenes")

    def plant(name, sections):
        path = folder / f"{name}.yaml"
        head = f"robot: {{urdf: {ROOT / 'config/robots/pendulum.urdf'}}}\n"
        path.write_text(head + sections, encoding="utf-8")
        return load_scene(path)

    return plant


def motion_of(name):
    return simulate(load_scene(SCENES / f"{name}.yaml"), 0.05, dt=1e-3)


def torques_of(name, **options):
    return inverse(load_scene(SCENES / f"{name}.yaml"), motion_of(name), **options)


def replayed():
    """The table of errors, of efforts that are known."""
    rng, stamps = np.random.default_rng(5), 1_763_800_000_000_000_007 + 5_000_001 * np.arange(40)
    efforts = rng.standard_normal((2, 40, 2))
    known, judged = (Motion(("a", "b"), stamps, e * 0.0, effort=e) for e in efforts)
    return Result(TorqueErrors(judged, known, 0.01).tables(), {"overall": 1.0})


RESULTS = {
    "simulate arm7": lambda plant: motion_of("arm7"),
    "simulate prosthetic_leg": lambda plant: motion_of("prosthetic_leg"),
    "simulate four_bar_leg": lambda plant: motion_of("four_bar_leg"),
    "simulate stops": lambda plant: simulate(plant("stops", STOPS), 0.3, dt=1e-3),
    "inverse of an open arm": lambda plant: torques_of("arm7", parts=True),
    "inverse of a coupled arm": lambda plant: torques_of("prosthetic_arm", parts=True),
    "inverse of a four-bar": lambda plant: torques_of("four_bar_leg"),
    "replay": lambda plant: replayed(),
}


@pytest.mark.parametrize("what", RESULTS)
def test_results_read_back_equal(what, tmp_path, planted):
    result = RESULTS[what](planted)
    samples = result["samples"]
    assert samples.rows > 20 and next(iter(samples)) == "time"
    assert all(column.unit for column in samples.columns if column.name != "time" or column.unit)
    for name in NAMES:
        if "errors" in result and suffix_of(name) in ("", ".mcap", ".db3"):
            with pytest.raises(DataError, match="column joint is str.* this format holds numbers"):
                result.to(tmp_path / name)
            continue
        result.to(tmp_path / name)
        read = read_result(tmp_path / name)
        if name == "o.npz":
            assert read == result
        elif name == "o.parquet":
            assert read["samples"] == samples and read.metadata == result.metadata
        elif ".csv" in name:
            assert [*read["samples"]] == [c for c in samples if c != "stamp"]
            assert (rounded(read["samples"]["time"]) == rounded(samples["time"])).all()
        else:
            assert read.metadata == result.metadata and read["samples"] == samples
            assert (stamps_of(read["samples"]) == stamps_of(samples)).all()
        for column, values in read["samples"].items():
            assert values.tobytes() == np.ascontiguousarray(samples[column]).tobytes()
    if "errors" in result:
        result.to(tmp_path / "errors.parquet", table="errors")
        assert read_result(tmp_path / "errors.parquet")["errors"] == result["errors"]


def test_metadata_says_where_a_result_comes_from():
    result = motion_of("four_bar_leg")
    about = result.metadata
    assert about["job"] == "simulate" and about["scene"].endswith("four_bar_leg.yaml")
    assert about["inputs"] == {"duration": 0.05, "start": 0.0, "dt": 1e-3}
    assert {"python", "mbd_ros", "pinocchio", "numpy"} == set(about["versions"])
    assert any("real-time factor" in line for line in about["remarks"])
    units = {column.name: column.unit for column in result["samples"].columns}
    assert units["time"] == "s" and units["energy"] == "J"
    assert units["ankle.position"] == "rad" and units["ankle.effort"] == "N·m"
    said = []
    scene = load_scene(SCENES / "arm7.yaml")
    told = simulate(scene, 0.01, say=said.append)
    assert "remarks" not in told.metadata and len(said) > 2
    torques = inverse(scene, told, derivatives="given", say=said.append)
    assert torques.metadata["inputs"]["motion"]["job"] == "simulate"


@pytest.mark.parametrize("name", ["memory", *NAMES])
def test_simulate_inverse_plot_with_a_file_in_between_and_without(tmp_path, name):
    """A bag has no accelerations on its JointState topic, so they are filtered from it."""
    scene, motion = load_scene(SCENES / "prosthetic_leg.yaml"), motion_of("prosthetic_leg")
    source = motion
    if name != "memory":
        source = tmp_path / name
        motion.to(source)
    kind = "zero-phase" if suffix_of(tmp_path / name) in ("", ".mcap", ".db3") else "given"
    kind = "given" if name == "memory" else kind
    torques = inverse(scene, source, derivatives=kind)
    direct = inverse(scene, motion, derivatives=kind)
    close = {"rtol": 0, "atol": 1e-6} if kind == "zero-phase" else {"rtol": 0, "atol": 0}
    for column in scene.couplings.independent:
        ours, known = (t["samples"][f"{column}.effort"] for t in (torques, direct))
        np.testing.assert_allclose(ours, known, **close)
    drawn = torques.plot(tmp_path / "o.png", columns=["effort"])
    assert (tmp_path / "o.png").read_bytes()[:4] == b"\x89PNG"
    assert len(drawn.axes[0].lines) == len(scene.couplings.independent)


def test_a_simulation_starts_from_a_result():
    scene = load_scene(SCENES / "arm7.yaml")
    first = simulate(scene, 0.02, dt=1e-3)
    second = simulate(scene, 0.01, dt=1e-3, origin=first, start=0.02)
    for column in ("time", "joint2.position", "joint2.velocity"):
        assert second["samples"][column][0] == first["samples"][column][-1]


def test_plot_is_a_command(tmp_path, capsys):
    motion_of("arm7").to(tmp_path / "m.npz")
    words = ["plot", str(tmp_path / "m.npz"), "-o", str(tmp_path / "m.svg"), "--columns", "effort"]
    assert main(words) == 0
    assert capsys.readouterr().out == f"51 rows -> {tmp_path / 'm.svg'}\n"
    assert (tmp_path / "m.svg").read_text().startswith("<?xml")
    assert main(["plot", str(tmp_path / "m.npz"), "-o", str(tmp_path / "m.csv")]) == 2
    assert "m.csv: expected the suffix .png, .svg, .pdf" in capsys.readouterr().err


def test_a_divergence_carries_what_was_reached(planted):
    with pytest.raises(Interrupted, match="at t = 0.4") as found:
        simulate(planted("stiff", STIFF), 100.0)
    reached = found.value.result
    assert reached["samples"].rows > 1 and "at t = 0.4" in reached.metadata["ended"]
    assert all(np.isfinite(values).all() for values in reached["samples"].values())


def test_ctrl_c_returns_what_there_is(planted):
    def interrupt(label, share):
        if share > 0:
            threading.Timer(0.0, os.kill, (os.getpid(), signal.SIGINT)).start()

    reached = simulate(planted("long", ""), 1000.0, dt=1e-3, progress=interrupt)
    assert "interrupted after t =" in reached.metadata["ended"]
    assert 1 < reached["samples"].rows < 1_000_000


def test_progress_is_told_to_a_callback():
    shares = []
    scene = load_scene(SCENES / "arm7.yaml")
    simulate(scene, 0.05, progress=lambda label, share: shares.append((label, share)))
    assert shares[0] == ("simulate", 0.0) and all(0 <= share <= 1 for _, share in shares)
