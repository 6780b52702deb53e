"""What a gripper holds: known bodies are weighed, with and without a known robot."""

import numpy as np
import pinocchio as pin
import pytest
from identification_data import moved, others

from mbd_ros.api import load_scene, scene_from
from mbd_ros.cli import main
from mbd_ros.features.identification.payload.job import payload
from mbd_ros.files.table import read_result

pytest.importorskip("clarabel", reason="clarabel is optional (extra: identification)")
HELD = pin.Inertia(1.7, np.array([0.01, -0.02, 0.09]), np.diag([0.004, 0.005, 0.003]))
FRAME = "flange"


def holding(scene):
    """The scene with a body in its hand."""
    given = scene.robot.inertias()
    return scene.with_inertias({FRAME: given[FRAME] + HELD})


def off(found):
    """Deviations by which mass and centre are off."""
    return (np.array([found.inertia.mass, *found.inertia.lever]) - [1.7, *HELD.lever]) / (
        found.deviation + 1e-12
    )


def test_without_noise_a_body_is_found_exactly():
    scene, t = load_scene("arm7"), np.arange(0.0, 10.0, 0.01)
    found = payload(scene, moved(scene, holding(scene), t), frame=FRAME)
    assert found.numbers == pytest.approx(HELD.toDynamicParameters(), abs=1e-8)
    assert found.inertia.mass == pytest.approx(1.7, abs=1e-4)
    assert found.inertia.lever == pytest.approx(HELD.lever, abs=1e-4)


def test_with_noise_it_is_within_its_deviations():
    scene, t = load_scene("arm7"), np.arange(0.0, 15.0, 0.01)
    found = payload(scene, moved(scene, holding(scene), t, noise=0.5), frame=FRAME)
    assert np.abs(off(found)).max() < 3.0
    assert 1e-4 < found.deviation[0] < 0.05


def test_an_unknown_robot_is_identified_without_it_first():
    """Masses 10 to 30 % off, gears that rub: with the given robot alone the mass is far off."""
    scene = scene_from({}, urdf="arm7")
    rub = [
        {"type": "gear_friction", "joint": n, "coulomb": 1.0, "viscous": 0.5, "smoothing": 0.02}
        for n in scene.couplings.independent
    ]
    true, t = others(scene).with_(forces=rub), np.arange(0.0, 20.0, 0.01)
    empty = moved(scene, true, t, seed=2, noise=0.05, amplitude=0.4)
    full = moved(scene, holding(true), t, seed=1, noise=0.05, amplitude=0.4)
    found = payload(scene, full, frame=FRAME, without=empty)
    assert found.inertia.mass == pytest.approx(1.7, abs=max(0.02, 3.0 * found.deviation[0]))
    assert found.inertia.lever == pytest.approx(HELD.lever, abs=0.01)
    wrong = payload(scene, full, frame=FRAME)
    assert abs(wrong.inertia.mass - 1.7) > 3.0 * abs(found.inertia.mass - 1.7)


def test_the_command_prints_and_writes(tmp_path, capsys):
    scene, t = load_scene("arm7"), np.arange(0.0, 10.0, 0.01)
    moved(scene, holding(scene), t, noise=0.1).to(tmp_path / "held.csv")
    out = tmp_path / "payload.npz"
    words = ["payload", "arm7", str(tmp_path / "held.csv"), "--frame", FRAME, "-o", str(out)]
    assert main(words) == 0
    assert "flange carries 1.7" in capsys.readouterr().out
    table = read_result(out)["samples"]
    assert table["value"][list(table["name"]).index("mass")] == pytest.approx(1.7, abs=0.02)
    assert main([*words[:-2], "--frame", "no_link"]) == 2
    assert "no frame 'no_link'" in capsys.readouterr().err
