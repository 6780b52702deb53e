"""Names of parts: unique in a scene, without dots, shown by check."""

import importlib

import pytest

from mbd_ros.api import scene_from
from mbd_ros.core.contracts import Load, type_name
from mbd_ros.errors import SceneError
from mbd_ros.scene.schema.registry import PARTS, resolve

SPRING = {"type": "joint_spring", "joint": "ankle", "stiffness": 30.0}
BAR = {"type": "distance", "frame_a": "world", "frame_b": "foot", "distance": 0.9}
FAR = {"lower": -9.0, "upper": 9.0}  # of what the bar makes of the leg
LEG = "prosthetic_leg"


def names(scene):
    return [p.name for p in (*scene.constraints, *scene.forces, *scene.actuators)]


def test_a_part_goes_by_its_place_and_type_numbered_where_that_repeats():
    scene = scene_from(
        {
            "constraints": [
                BAR,
                {**BAR, "frame_a": "foot", "frame_b": "world"},
                {"type": "joint_stop", "joints": ["all"], **FAR},
                {"type": "joint_stop", "joints": ["knee"], **FAR},
            ],
            "forces": [SPRING, SPRING, {**SPRING, "name": "cushion"}],
            "actuators": [{"type": "ideal", "joints": ["hip_flexion", "ankle"]}],
        },
        urdf=LEG,
    )
    assert names(scene) == [
        "foot_distance",
        "foot_distance_2",
        "joint_stop",
        "knee_joint_stop",
        "ankle_joint_spring",
        "ankle_joint_spring_2",
        "cushion",
        "ideal",
    ]
    lines = scene.check()
    assert all(f"{name}, " in lines for name in names(scene))


def test_a_given_name_makes_a_default_give_way():
    scene = scene_from({"forces": [SPRING, {**SPRING, "name": "ankle_joint_spring"}]}, urdf=LEG)
    assert names(scene) == ["ankle_joint_spring_2", "ankle_joint_spring"]


@pytest.mark.parametrize("name", ["left.heel", "", "two words", "a#2", 3, None, "n" * 256])
def test_a_name_that_is_none_is_refused(name):
    with pytest.raises(SceneError, match=r"forces\[0\].name: expected a name .* without a dot"):
        scene_from({"forces": [{**SPRING, "name": name}]}, urdf=LEG)


@pytest.mark.parametrize(
    ("sections", "owner"),
    [
        ({"forces": [{**SPRING, "name": "a"}] * 2}, "a part of forces"),
        ({"forces": [{**SPRING, "name": "ankle"}]}, "a joint of the robot"),
        (
            {"forces": [{**SPRING, "name": "a"}], "constraints": [{**BAR, "name": "a"}]},
            "a part of ",
        ),
        (
            {"forces": [{**SPRING, "name": "a"}], "external_wrenches": {"a": {"frame": "foot"}}},
            "a part of ",
        ),
    ],
)
def test_names_are_unique_in_a_scene(sections, owner):
    with pytest.raises(SceneError, match=f"name '.*' is that of {owner}"):
        scene_from(sections, urdf=LEG)


def test_other_sections_keep_the_names_of_parts():
    scene = scene_from({"forces": [{**SPRING, "name": "a"}]}, urdf=LEG)
    changed = scene.with_(constraints=[BAR])
    assert names(changed) == ["foot_distance", "a"]
    with pytest.raises(SceneError, match="name 'a' is that of a part of"):
        scene.with_(constraints=[{**BAR, "name": "a"}])


def test_every_type_of_the_registry_is_the_word_of_its_class():
    for section in ("actuators", "constraints", "forces"):
        assert [type_name(resolve(section, t, "here")) for t in PARTS[section]] == [
            *PARTS[section]
        ]


def test_a_part_that_no_scene_has_built_goes_by_its_type():
    class HardSpring(Load):
        pass

    assert HardSpring().name == "hard_spring"


class Loose:
    """Offers the method of a force, and derives from no contract."""

    def __init__(self, robot):
        pass

    def force(self, k, x, u):
        return 0.0


def test_a_part_without_its_contract_is_told_a_class_that_exists():
    with pytest.raises(SceneError, match="must derive from") as caught:
        scene_from({"forces": [{"type": Loose}]}, urdf="arm7")
    module, _, name = str(caught.value).rpartition("must derive from ")[2].rpartition(".")
    assert hasattr(importlib.import_module(module), name)
