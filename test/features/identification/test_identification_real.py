"""Identification of real arms and of a person, from recordings of others."""

import numpy as np
import pytest
from places import RECORDINGS

from mbd_ros.api import load_scene
from mbd_ros.cli import main
from mbd_ros.core.model.inertial_parameters import is_consistent, parameters_of
from mbd_ros.features.identification.job import identify

pytest.importorskip("clarabel", reason="clarabel is optional (extra: identification)")
PANDA = "rename: {" + ", ".join(f"panda_joint{i}: fer_joint{i}" for i in range(1, 8)) + "}"
ARMS = {
    "panda": ("panda_nohand.urdf", PANDA, 2.8, 2.8),
    "ur10": ("ur10_robot.urdf", "base: fixed", 8.3, 8.3),  # the authors' own model
}


@pytest.mark.parametrize("name", [pytest.param("panda", marks=pytest.mark.soak), "ur10"])
def test_an_arm_that_was_not_looked_at_is_explained(tmp_path, capsys, name):
    """First 60 % -> last 40 %, no option."""
    urdf, more, in_band, as_measured = ARMS[name]
    scene, out = tmp_path / "arm.yaml", tmp_path / "out"
    text = f"robot:\n  urdf: {RECORDINGS / name / urdf}\n  {more}\n"
    scene.write_text(text, encoding="utf-8")
    assert main(["identify", str(scene), str(RECORDINGS / name / "bag"), "-o", str(out)]) == 0
    said = capsys.readouterr().out.split("identified scene ")
    assert float(said[1].split(" %")[0]) <= in_band
    assert float(said[1].split("measured torque ")[1].split(" %")[0]) <= as_measured
    bodies = parameters_of(load_scene(out / "scene.yaml").robot.model)
    assert all(is_consistent(numbers) for numbers in bodies)


def test_a_person_is_weighed_by_walking_over_plates():
    """No torques; the given masses are 20 % too small, the model's total is 72.6 kg."""
    folder = RECORDINGS / "gait10dof/walk"
    scene = load_scene(folder / "scene.yaml")
    mass = sum(inertia.mass for inertia in scene.robot.inertias().values())
    light = {
        link: (0.8 * one.mass, one.lever, 0.8 * one.inertia)
        for link, one in scene.robot.inertias().items()
        if one.mass > 0.0
    }
    found = identify(
        scene.with_inertias(light),
        folder / "motion.csv.gz",
        wrenches=folder / "external_wrenches.csv.gz",
        learned=1.0,
    )
    assert found.tables["bodies"]["mass"].sum() == pytest.approx(mass, rel=0.01)
    table = found.tables["base_parameters"]
    assert 5 <= np.sum(table["is_shown"]) < table.rows
    assert any("the others are" in line and "femur" in line for line in found.remarks)
