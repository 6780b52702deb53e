"""What is loaded is held against the plain tier before it is used."""

import pytest
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.compiled.build.compiler import BuildError
from mbd_ros.compiled.build.library import load
from mbd_ros.compiled.build.verify import verify
from mbd_ros.compiled.code.emit import emit
from mbd_ros.compiled.symbols.trace import trace

SCENES = ROOT / "config/scenes"


def compiled(system, real="double"):
    traced = trace(system)
    return load(emit([traced.function("accelerate")], real)), traced


@pytest.mark.parametrize("real", ["double", 4])
@pytest.mark.parametrize(
    "name", ["prosthetic_leg", "free_flyer", "benchmark/x02_four_bar_1e-2", "benchmark/arm7_swing"]
)
def test_the_code_of_a_scene_is_accepted(name, real):
    system = load_scene(SCENES / f"{name}.yaml").system()
    verify(*compiled(system, real), system)


def test_the_code_of_another_scene_is_refused():
    system = load_scene(SCENES / "benchmark/arm7_swing.yaml").system()
    other = load_scene(SCENES / "benchmark/arm7_swing.yaml").with_(gravity=[0.0, 0.0, -9.8])
    with pytest.raises(BuildError, match=r"compiled accelerations differ by .* of the tier aba"):
        verify(*compiled(system), other.system())


def test_the_code_of_every_function_is_looked_at():
    scene = load_scene(SCENES / "benchmark/x02_four_bar_1e-2.yaml")
    given = {**scene.entries["robot"], "gravity": [0.0, 0.0, -9.8]}
    system, heavier = scene.system(), scene.with_(robot=given)
    traced, other = trace(system), trace(heavier.system())
    names = "accelerate", "place", "settle", "expand"
    wrong = other.function("energy")
    library = load(emit([*(traced.function(name) for name in names), wrong]))
    with pytest.raises(BuildError, match=r"values of 'energy' differ by .* from its expressions"):
        verify(library, traced, system)
