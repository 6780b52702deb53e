"""Parameters of the nodes: those that are promised, and how they follow from constructors."""

import json
import math
from importlib import import_module
from pathlib import Path
from typing import get_origin

import pytest
import yaml
from nodes.conftest import ROOT

from mbd_ros.nodes.controller import laws
from mbd_ros.nodes.shell.parameters import PARAMETERS
from mbd_ros.nodes.table import NODES
from mbd_ros.scene.arguments import arguments
from mbd_ros.scene.reader import load_scene
from mbd_ros.scene.registry import PARTS, resolve

PROMISED = json.loads(Path(__file__).with_name("parameters.json").read_text(encoding="utf-8"))

OF_THE_SHELL = {parameter.name for parameter in PARAMETERS}


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
def test_no_parameter_is_lost_or_changes_its_type_default_range_or_when_it_may_change(name):
    """`parameters.json` holds what release 0.1.0 promises; new parameters are welcome."""
    now = {key: row(parameter) for key, parameter in declared(name).items()}
    promised = PROMISED[name]
    assert list(now)[: len(promised)] == list(promised)
    assert {key: now[key] for key in promised} == promised


@pytest.mark.parametrize("name", NODES)
def test_the_parameter_file_holds_every_parameter_with_its_default(name):
    path = ROOT / f"config/nodes/{name}.yaml"
    given = yaml.safe_load(path.read_text(encoding="utf-8"))["/**"]["ros__parameters"]
    own = {key: p.default for key, p in declared(name).items() if key not in OF_THE_SHELL}
    assert given.keys() == own.keys()
    for key in given.keys() - {"scene"}:
        assert given[key] == (list(own[key]) if isinstance(own[key], tuple) else own[key]), key
    assert load_scene(given["scene"]).robot.joints


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
                assert gain.unit and f"[{gain.unit}]" in parameter.text
            assert gain.text.rstrip(".") in parameter.text
            assert len(names) == 1 or law in parameter.text
            assert not parameter.read_only


def test_every_registered_law_has_a_node():
    assert {*laws.OTHERS, *laws.OF_QP} == PARTS["controllers"].keys()
    assert declared("sliding_mode_controller")["controller"].choices == laws.OTHERS


def resolved(law):
    return resolve("controllers", law, "test")
