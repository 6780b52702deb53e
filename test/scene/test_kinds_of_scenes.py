"""One scene of each kind, from its file to a motion and back to the efforts that explain it."""

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.cli import main

KINDS = {  # kind -> scene, simulated time [s]
    "open chain": ("arm7", 0.2),
    "coupled joints": ("prosthetic_arm", 0.2),
    "sliding knee": ("prosthetic_leg", 0.2),
    "loop": ("four_bar_leg", 0.2),
    "loop and joint stops": ("press", 0.1),
    "contact with impacts": ("rimless_wheel", 0.2),
    "phases": ("kneed_walker", 0.2),
    "free bodies": ("free_flyer", 0.2),
    "rolling contact": ("sphere_on_plane", 0.1),
}
ROUNDING = 1.0e-11  # N·m or N, beside loads of 1 to 100


@pytest.mark.parametrize("kind", KINDS)
def test_the_forces_of_a_scene_explain_its_motion(kind):
    """A mechanism that only its own forces move needs no efforts and leaves no residual."""
    name, seconds = KINDS[kind]
    scene = mbd.load_scene(name)
    motion = scene.simulate(seconds)
    table = scene.inverse(motion)["samples"]
    columns = [c for c in table if c.endswith(".effort") or ".residual." in c]
    assert columns
    assert max(np.abs(table[c]).max() for c in columns) < ROUNDING


def test_the_forces_of_muscles_are_the_efforts_of_their_motion():
    scene = mbd.load_scene("muscle_leg")
    motion = scene.simulate(0.05)
    efforts = scene.inverse(motion)["samples"]
    for joint in ("hip.effort", "ankle.effort"):  # those that no coupling loads
        np.testing.assert_allclose(efforts[joint], motion["samples"][joint], atol=ROUNDING)
        assert np.abs(efforts[joint]).max() > 0.1


def test_molecules_keep_their_energy():
    energy = mbd.load_scene("particles/water_spce").simulate(0.02)["samples"]["energy"]
    assert np.ptp(energy) < 1.0e-3 * np.abs(energy[0])


@pytest.mark.parametrize("scene", [name for name, _ in KINDS.values()])
def test_a_scene_is_described(scene, capsys):
    assert main(["check", scene]) == 0
    assert capsys.readouterr().out
