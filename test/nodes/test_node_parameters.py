"""Parameters of the nodes: those that are promised, and how they follow from constructors."""

import json
import math
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path
from typing import get_origin

import pytest
import yaml
from nodes.joint_stream import ACTIVE
from places import ROOT

from mbd_ros.cli import main
from mbd_ros.features.control.loop_watch import ChatterMeter
from mbd_ros.features.control.reference import ReferenceGenerator
from mbd_ros.methods.inverse_dynamics.torque_estimator import Tuning
from mbd_ros.methods.projection.state_projection import StateProjector
from mbd_ros.nodes.controller import parameters as laws
from mbd_ros.nodes.shell.parameters import PARAMETERS
from mbd_ros.nodes.table import NODES
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.schema.registry import PARTS, resolve
from mbd_ros.scene.schema.schema import arguments

PROMISED = json.loads(Path(__file__).with_name("parameters.json").read_text(encoding="utf-8"))


def declared(name):
    """Parameters of a node by name."""
    module, _, node = NODES[name].partition(":")
    return {p.name: p for p in PARAMETERS + getattr(import_module(module), node).PARAMETERS}


def row(parameter):
    """A parameter as `parameters.json` has it: without text, and without what is not limited."""
    kind = parameter.kind
    found = {
        "kind": kind.__name__ if get_origin(kind) is None else str(kind),
        "default": parameter.default,
        "low": None if parameter.low == -math.inf else parameter.low,
        "high": None if parameter.high == math.inf else parameter.high,
        "length": parameter.length,
        "choices": parameter.choices or None,
        "read_only": parameter.read_only,
        "fixed": parameter.fixed,
    }
    limited = {k: v for k, v in found.items() if v is not None or k == "default"}
    return json.loads(json.dumps(limited))


@pytest.mark.parametrize("name", NODES)
def test_a_node_class_is_at_most_three_levels_below_that_of_rclpy(name):
    module, _, node = NODES[name].partition(":")
    levels = getattr(import_module(module), node).__mro__
    assert sum(level.__module__.startswith("mbd_ros.") for level in levels) <= 3


@pytest.mark.parametrize("name", NODES)
def test_no_parameter_is_lost_or_changes_its_type_default_range_or_when_it_may_change(name):
    """`parameters.json` holds what the last release promises; new parameters are welcome."""
    now = {key: row(parameter) for key, parameter in declared(name).items()}
    promised = PROMISED[name]
    assert list(now)[: len(promised)] == list(promised)
    assert {key: now[key] for key in promised} == promised


def printed(capsys, name):
    """The parameter file of a node."""
    assert main(["params", name]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("name", NODES)
def test_the_printed_file_has_every_parameter_with_meaning_range_and_default(capsys, name):
    text, own = printed(capsys, name), declared(name)
    given = yaml.safe_load(text)["/**"]["ros__parameters"]
    required = {key for key, parameter in own.items() if parameter.default is None}
    assert given.keys() == own.keys() - required
    for key, value in given.items():
        assert own[key].read(value) == own[key].default, key
        assert type(value) is (own[key].kind if get_origin(own[key].kind) is None else list)
    comment = []
    for line in text.splitlines()[3:]:
        key = re.fullmatch(r"    (?:([a-z_.]+): .*|# ([a-z_.]+): [A-Z_]+)", line)
        if not key:
            comment.append(line.removeprefix("    # "))
            continue
        parameter, said = own.pop(key[1] or key[2]), " ".join(comment)
        comment.clear()
        assert said.startswith(parameter.text)
        assert parameter.high == math.inf or f"{parameter.low:g} to {parameter.high:g}" in said
        assert all(choice in said for choice in parameter.choices)
        assert ("Required" in said) == (parameter.name in required) == bool(key[2])
        assert ("May change at run time" in said) == (not parameter.read_only)
    assert not own
    assert max(map(len, text.splitlines())) < 100


@pytest.mark.parametrize("name", NODES)
def test_the_file_of_the_package_is_the_printed_one_with_a_scene(capsys, name):
    """Else print it anew: mbd-ros params NODE > config/nodes/NODE.yaml, with the scene."""
    kept = (ROOT / f"config/nodes/{name}.yaml").read_text(encoding="utf-8").splitlines()
    new = printed(capsys, name).splitlines()
    different = [(a, b) for a, b in zip(kept, new, strict=True) if a != b]
    assert len(different) == 1
    assert re.fullmatch("    (# )?scene: .*", different[0][1])
    scene = yaml.safe_load("\n".join(kept))["/**"]["ros__parameters"]["scene"]
    assert load_scene(scene).robot.joints


@pytest.mark.parametrize("name", ["simulator", "sliding_mode_controller"])
def test_a_node_takes_the_printed_file_once_what_is_required_is_given(capsys, start_node, name):
    text, scene = printed(capsys, name), ROOT / "config/scenes/controlled_arm.yaml"
    target = ("-m", "mbd_ros.nodes", name)
    lacking = start_node(text, target=target)
    lacking.wait_for("parameter 'scene' must be given")
    assert lacking.stop() == 0
    given = text.replace("# scene: SCENE", f"scene: {scene}")
    assert given != text
    node = start_node(given, target=target)
    node.wait_for(ACTIVE)
    assert node.stop() == 0
    assert "WARN" not in node.log and "ERROR" not in node.log


def test_ros_is_imported_when_a_file_is_printed_and_not_before():
    code = "import sys, contextlib\nfrom mbd_ros.cli import main\n"
    code += "with contextlib.suppress(SystemExit): main(sys.argv[1:])\n"
    code += "print('rclpy' in sys.modules)"
    for words, is_imported in ((["--help"], "False"), (["simulator"], "True")):
        ran = [sys.executable, "-c", code, "params", *words]
        done = subprocess.run(ran, capture_output=True, text=True, check=True, cwd=ROOT)
        assert done.stdout.splitlines()[-1] == is_imported


@pytest.mark.parametrize("name", NODES)
def test_every_parameter_says_what_it_means(name):
    for parameter in declared(name).values():
        assert len(parameter.text) > 8 and parameter.text.endswith("."), parameter


@pytest.mark.parametrize(
    ("node", "names"),
    [("sliding_mode_controller", laws.OTHERS), ("qp_controller", laws.OF_QP)],
)
def test_gains_are_the_arguments_of_the_laws_and_nothing_else(node, names):
    """Laws that share a gain agree on it: the parameter has one default and one range."""
    own = {key: p for key, p in declared(node).items() if key.startswith("gains.")}
    assert own.keys() == {
        f"gains.{gain.name}" for law in names for gain in arguments(resolved(law), skip=1)
    }
    for law in names:
        for gain in arguments(resolved(law), skip=1):
            parameter = own[f"gains.{gain.name}"]
            default = parameter.default[0] if gain.per_joint else parameter.default
            assert (default, parameter.low) == (gain.default, gain.low), (law, gain.name)
            assert (parameter.high, parameter.choices) == (gain.high, gain.choices)
            if gain.kind is float:
                assert gain.unit == "-" or f"[{gain.unit}]" in parameter.text
            assert gain.text.rstrip(".") in parameter.text
            assert len(names) == 1 or law in parameter.text
            assert not parameter.read_only


def test_every_registered_law_has_a_node():
    assert {*laws.OTHERS, *laws.OF_QP} == PARTS["controllers"].keys()
    assert declared("sliding_mode_controller")["controller"].choices == laws.OTHERS


def resolved(law):
    return resolve("controllers", law, "test")


@pytest.mark.parametrize(
    ("node", "constructor", "names", "skip"),
    [
        ("inverse_dynamics", Tuning, {name: name for name in Tuning._fields}, 0),
        ("joint_state_projector", StateProjector, {"amplification": "amplification"}, 1),
        ("qp_controller", ChatterMeter, {"cutoff": "chatter_cutoff"}, 1),
        (
            "qp_controller",
            ReferenceGenerator,
            {name: f"reference_{name}" for name in ("ramp", "ramp_speed", "timeout")},
            1,
        ),
    ],
)
def test_what_goes_straight_into_a_constructor_has_its_default_and_range(
    node, constructor, names, skip
):
    own = declared(node)
    found = {a.name: a for a in arguments(constructor, skip, tuple(names))}
    assert found.keys() == names.keys()
    for argument, name in names.items():
        given, parameter = found[argument], own[name]
        assert (given.default, given.low, given.high) == parameter[3:6]
        assert given.low > -math.inf and given.high < math.inf
        assert parameter.text.startswith(given.text.rstrip("."))
