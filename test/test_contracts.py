"""What every registered part must keep to, found through the registry."""

import inspect
from pathlib import Path

import numpy as np
import pytest

from mbd_ros import schema
from mbd_ros.core.robot_reader import read_robot
from mbd_ros.core.state import State
from mbd_ros.errors import SceneError
from mbd_ros.registry import METHODS, PARTS, resolve

LEG = (Path(__file__).parents[1] / "config/robots/prosthetic_leg.urdf").read_text(encoding="utf-8")
NAMES = [(section, name) for section, names in PARTS.items() for name in names]
every_part = pytest.mark.parametrize(("section", "name"), NAMES)


@pytest.fixture(scope="module")
def robot():
    return read_robot(LEG)


def built(section, name, robot):
    part = resolve(section, name, "here")
    return schema.call(part, dict(part.example), f"{section}.{name}", robot)


def test_every_section_of_the_registry_has_a_contract():
    assert set(METHODS) == set(PARTS)
    assert NAMES


@every_part
def test_part_lives_in_a_file_of_its_name_in_the_folder_of_its_section(section, name):
    part = resolve(section, name, "here")
    assert part.__module__ == f"mbd_ros.{section}.{name}"
    assert part.__name__ == "".join(word.capitalize() for word in name.split("_"))


@every_part
def test_constructor_takes_a_robot_and_then_documented_keywords(section, name):
    part = resolve(section, name, "here")
    first, *rest = inspect.signature(part).parameters.values()
    assert first.name == "robot"
    assert all(p.kind is p.KEYWORD_ONLY for p in rest)
    assert all(p.annotation is not p.empty for p in rest)
    assert all(f"{p.name}: " in part.__doc__ for p in rest)


@every_part
def test_example_builds_and_a_typo_in_it_is_named(section, name, robot):
    assert built(section, name, robot)
    part = resolve(section, name, "here")
    for key in part.example:
        typo = {**part.example, f"{key}_": part.example[key]}
        with pytest.raises(SceneError, match=rf"here: unknown key '{key}_', accepted: .*{key}"):
            schema.call(part, typo, "here", robot)
        wrong = {**part.example, key: ["x"]}
        with pytest.raises(SceneError, match=rf"here\.{key}: expected a .*, got \['x'\]"):
            schema.call(part, wrong, "here", robot)


@every_part
def test_unknown_joint_is_named_with_those_that_exist(section, name, robot):
    part = resolve(section, name, "here")
    with pytest.raises(SceneError, match="here: no joint 'nose'; the robot has hip_flexion, "):
        schema.call(part, {**part.example, "joint": "nose"}, "here", robot)


@pytest.mark.parametrize("name", PARTS["forces"])
def test_force_is_fresh_finite_and_changes_nothing(name, robot):
    part, data, rng = built("forces", name, robot), robot.model.createData(), np.random
    x = State(0.0, *rng.default_rng(0).normal(size=(2, robot.model.nv)))
    before = x.q.copy(), x.v.copy()
    first, second = part.force(data, x), part.force(data, x)
    assert first.shape == (robot.model.nv,)
    assert np.isfinite(first).all()
    assert first.any()
    assert np.array_equal(first, second)
    assert first is not second
    first[:] = 7.0
    assert np.array_equal(part.force(data, x), second)
    assert np.array_equal(x.q, before[0])
    assert np.array_equal(x.v, before[1])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("joint_sprong", "here: unknown type 'joint_sprong', accepted: joint_friction, joint_spr"),
        ("", "here: unknown type ''"),
        (":Spring", "here: unknown type ':Spring'"),
        ("my_parts:", "here: unknown type 'my_parts:'"),
        (".my_parts:Spring", "here: unknown type '.my_parts:Spring'"),
        ("my/parts:Spring", "here: unknown type 'my/parts:Spring'"),
        ("no_such_module:Spring", "type 'no_such_module:Spring': No module named"),
        ("json:Spring", "type 'json:Spring': module 'json' has no attribute 'Spring'"),
        ("os:system", "type 'os:system' is not a class with a method 'force'"),
        ("builtins:int", "type 'builtins:int' is not a class with a method 'force'"),
        ("math:pi", "type 'math:pi' is not a class with a method 'force'"),
    ],
)
def test_type_that_is_no_part_is_named_with_those_that_exist(name, message):
    with pytest.raises(SceneError) as caught:
        resolve("forces", name, "here")
    assert message in str(caught.value)
