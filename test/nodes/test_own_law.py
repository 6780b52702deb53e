"""A control law of another package in a controller node: the one that docs/control.md shows."""

import re
import sys
from importlib import import_module

import numpy as np
import pytest
import yaml
from nodes.control_client import controlled
from nodes.simulation_client import NAME, simulated
from places import ROOT
from rcl_interfaces.srv import DescribeParameters, GetParameters

from mbd_ros.api import load_scene
from mbd_ros.core.state import State
from mbd_ros.methods.control.contract import EffortBox, Reference

PAGE = (ROOT / "docs/control.md").read_text(encoding="utf-8")
(LAW,) = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
(FILE,) = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)
GIVEN = yaml.safe_load(FILE)["/**"]["ros__parameters"]
SCENE = (ROOT / "config/scenes/controlled_arm.yaml").read_text(encoding="utf-8")
SCENE = SCENE.replace("../robots", str(ROOT / "config/robots"))
TARGET = ("-m", "mbd_ros.nodes", "sliding_mode_controller")
NODE = "/sliding_mode_controller"
OTHERS = """
from typing import Annotated
from mbd_ros.methods.control.contract import Controller
from mbd_ros.parts.controllers.computed_torque import ComputedTorque
class Demanding(ComputedTorque):
    def __init__(self, joints, *, kp: float, order: int = 2) -> None: ...
class Odd(ComputedTorque):
    def __init__(self, joints, *, kp: dict[str, float]) -> None: ...
class Lonely(ComputedTorque):
    def __init__(self, *, joints: float = 1.0) -> None: ...
class Idle(Controller):
    pass
class Stray:
    def effort(self):
        pass
def function():
    pass
"""


@pytest.fixture
def laws(tmp_path_factory, monkeypatch):
    """A folder on the path of this process and of the nodes that it starts."""
    folder = tmp_path_factory.mktemp("laws")
    (folder / "soft_spring.py").write_text(LAW, encoding="utf-8")
    (folder / "other_laws.py").write_text(OTHERS, encoding="utf-8")
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("PYTHONPATH", str(folder), prepend=":")
    yield folder
    for name in ("soft_spring", "other_laws"):
        sys.modules.pop(name, None)


@pytest.fixture
def scene(tmp_path):
    path = tmp_path / "arm.yaml"
    path.write_text(SCENE, encoding="utf-8")
    return path


def ask(probe, kind, service, *names):
    """Values or descriptors of parameters."""
    return probe.call(kind, f"{NODE}/{service}", kind.Request(names=list(names)))


def value(probe, name):
    return ask(probe, GetParameters, "get_parameters", name).values[0]


def test_the_law_of_the_page_is_the_equation_that_it_states(laws, scene):
    loaded, rng = load_scene(scene), np.random.default_rng(0)
    joints = loaded.controlled_joints()
    n = len(joints)
    law = import_module("soft_spring").SoftSpring(joints, kp=60.0, kd=15.0, reach=0.2)
    simulation = loaded.simulation()
    q = loaded.initial.q + 0.05 * rng.normal(size=loaded.robot.model.nq)
    start = State(0.0, q, rng.normal(size=loaded.robot.model.nv))
    x = simulation.system.expand(simulation.start(start))
    ref = Reference(*rng.normal(size=(3, n)))
    box = EffortBox(np.full(n, -np.inf), np.full(n, np.inf))
    control = law.effort(x, ref, law.begin(), box)
    system = loaded.system()
    a = system.evaluate(x, control.effort).a[[joint.v for joint in joints.joints]]
    e, rate = joints.positions(x) - ref.q, joints.velocities(x) - ref.v
    expected = ref.a - 15.0 * rate - 60.0 * 0.2 * np.tanh(e / 0.2)
    np.testing.assert_allclose(a, expected, rtol=1e-9)


def test_it_controls_the_simulator_in_lock_step_with_gains_from_a_file(domain, tmp_path, laws):
    """From the pose at the start to a target, on to the equation's rest; then with other gains."""
    (plant := tmp_path / "plant").mkdir()
    (folder := tmp_path / "controller").mkdir()
    given = {name.replace(".", "__"): value for name, value in GIVEN.items() if name != "scene"}
    given |= {"allow_code": "true", "use_sim_time": "true"}
    locked = {"lock_step": "true", "publish_clock": "true"}
    with simulated(domain, plant, SCENE, **locked) as arm:
        arm.probe.node.destroy_publisher(arm._vectors)
        with controlled(domain, folder, SCENE, plant=NAME, **given) as client:
            client.probe.spin_until(lambda: client.states)
            robot, names = client.scene.robot, list(client.scene.actuated)
            at = [[joint.name for joint in robot.joints].index(name) for name in names]
            target = np.array(arm.newest.position)[at] + 0.1
            client.refer(target.tolist(), names)

            def is_there():
                arm.probe.spin_for(0.02)
                return np.abs(np.array(arm.newest.position)[at] - target).max() < 1e-4

            client.probe.spin_until(is_there)
            client.probe.spin_until(lambda: np.abs(client.states[-1].position).max() < 1e-3)
            arm.probe.spin_for(0.1)
            ticks = np.unique(arm.stamps())
            assert len(ticks) > 200
            assert (np.diff(ticks[1:]) == 1_000_000).all()
            reach = value(client.probe, "gains.reach")
            assert (reach.type, reach.double_value) == (3, 0.2)
            assert list(value(client.probe, "gains.kp").double_array_value) == GIVEN["gains.kp"]
            assert list(value(client.probe, "gains.kd").double_array_value) == [20.0]
            names = ("gains.reach", "gains.kp")
            told = ask(client.probe, DescribeParameters, "describe_parameters", *names)
            told = told.descriptors
            assert told[0].description.startswith("Error from which the pull hardly grows [rad")
            assert told[0].floating_point_range[0].from_value == 0.01
            assert "Of computed_torque" not in told[1].description
            result = client.probe.set_parameter(NODE, "gains.reach", 20.0)
            assert not result.successful and "range Min: 0.01, Max: 10" in result.reason
            result = client.probe.set_parameter(NODE, "gains.kd", [1.0, 2.0])
            assert not result.successful and "'gains.kd' has 2 values" in result.reason
            result = client.probe.set_parameter(NODE, "gains.kd", [-1.0] * 4)
            assert not result.successful
            assert client.probe.set_parameter(NODE, "gains.kd", [12.0]).successful
            result = client.probe.set_parameter(NODE, "controller", "sliding_mode")
            assert not result.successful and "read-only while" in result.reason


@pytest.mark.parametrize(
    ("law", "allowed", "reason"),
    [
        (
            "soft_spring:SoftSpring",
            False,
            "names code of others, of which nothing was imported: t",
        ),
        ("no_such_laws:Law", True, "No module named 'no_such_laws'; looked for in "),
        ("soft_spring:Hard", True, "module 'soft_spring' has no attribute 'Hard'"),
        ("other_laws:function", True, "is not a class with a method 'effort'"),
        ("other_laws:Stray", True, "must inherit mbd_ros.methods.control.contract:Controller and"),
        ("other_laws:Idle", True, "must inherit mbd_ros.methods.control.contract:Controller and"),
        ("other_laws:Lonely", True, "must take (joints, *, gains), joints as its first argument"),
        ("other_laws:Odd", True, "argument 'kp' has the annotation dict[str, float]; accepted: f"),
        ("other_laws:Demanding", True, "parameter 'gains.kp' must be given: finite float"),
    ],
)
def test_what_is_no_law_or_not_allowed_is_named(
    start_node, probe, laws, scene, law, allowed, reason
):
    values = f"scene: {scene}, controller: '{law}', allow_code: {str(allowed).lower()}"
    node = start_node(f"/**: {{ros__parameters: {{{values}}}}}\n", target=TARGET)
    node.wait_for(reason)
    node.wait_for(
        "parameter 'gains.kp'" if "must be given" in reason else "parameter 'controller'"
    )
    assert probe.state(NODE) == "unconfigured"
    assert probe.set_parameter(NODE, "scene", "another").successful
    assert node.stop() == 0
    assert "Traceback" not in node.log


def test_gains_follow_the_law_that_is_chosen_before_configuring(start_node, probe, laws, scene):
    """Gains of the other law come and go; what was given at the start holds for whoever has it."""
    given = f"scene: {scene}, allow_code: true, autostart: false, gains.kp: [70], gains.reach: 1"
    node = start_node(f"/**: {{ros__parameters: {{{given}}}}}\n", target=TARGET)
    node.wait_for("parameter 'gains.reach' is unknown")
    assert probe.set_parameter(NODE, "gains.kd", [3.0]).successful
    assert probe.set_parameter(NODE, "gains.gain", [61.0]).successful
    result = probe.set_parameter(NODE, "controller", "soft_spring:Hard")
    assert not result.successful and "has no attribute 'Hard'" in result.reason
    assert probe.set_parameter(NODE, "controller", "soft_spring:SoftSpring").successful
    assert value(probe, "gains.reach").double_value == 1.0
    assert list(value(probe, "gains.kp").double_array_value) == [70.0]
    assert list(value(probe, "gains.kd").double_array_value) == [20.0]
    assert list(value(probe, "gains.gain").double_array_value) == [61.0]
    assert probe.change_state(NODE, "configure")
    assert probe.change_state(NODE, "cleanup")
    assert probe.set_parameter(NODE, "controller", "computed_torque").successful
    assert list(value(probe, "gains.kd").double_array_value) == [40.0]
    assert list(value(probe, "gains.kp").double_array_value) == [70.0]
    assert ask(probe, GetParameters, "get_parameters", "gains.reach").values == []
    assert probe.change_state(NODE, "configure")
    assert node.stop() == 0
