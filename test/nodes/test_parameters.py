"""Parameters of the real nodes as `ros2 param` sees and sets them."""

import pytest
from nodes.simulation_client import ARM, PENDULUM
from places import ROOT
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from std_msgs.msg import String

from mbd_ros.nodes.shell.robot_description import LATCHED
from msg_adapters.diagnostics import ERROR

NODES = (
    *("simulator", "sliding_mode_controller", "qp_controller"),
    *("inverse_dynamics", "joint_state_projector", "muscle_forces", "web_view"),
)


def module(name):
    return ("-m", "mbd_ros.nodes", name)


def got(probe, node):
    """Name -> ParameterValue, by one request for all of them: so `ros2 param dump` asks."""
    names = probe.call(ListParameters, f"{node}/list_parameters", ListParameters.Request())
    request = GetParameters.Request(names=names.result.names)
    values = probe.call(GetParameters, f"{node}/get_parameters", request).values
    return dict(zip(request.names, values, strict=True))


@pytest.mark.parametrize("name", NODES)
def test_every_parameter_has_a_value_of_its_type_before_anything_was_given(
    start_node, probe, name
):
    start_node(target=module(name))
    health = probe.wait_health(lambda h: h.level == ERROR)
    assert "parameter 'scene' must be given" in health.message
    values = got(probe, f"/{name}")
    assert {n for n, v in values.items() if v.type == ParameterType.PARAMETER_NOT_SET} == set()
    assert (values["scene"].type, values["scene"].string_value) == (4, "")
    assert len(values) > 10
    if "joints" in values:
        joints = values["joints"]
        assert (joints.type, joints.string_array_value) == (
            ParameterType.PARAMETER_STRING_ARRAY,
            [],
        )
    if "effort_limit" in values:
        assert values["effort_limit"].type == ParameterType.PARAMETER_DOUBLE_ARRAY


def test_what_needs_a_new_configuration_can_be_set_before_it_and_not_within(
    start_node, probe, tmp_path
):
    scene, other = tmp_path / "arm.yaml", tmp_path / "pendulum.yaml"
    scene.write_text(ARM, encoding="utf-8")
    other.write_text(PENDULUM, encoding="utf-8")
    start_node(target=module("simulator"))
    probe.wait_health(lambda h: h.level == ERROR)
    for name, value in (("scene", str(scene)), ("rate", 250), ("joints", [])):
        result = probe.set_parameter("/simulator", name, value)
        assert result.successful, result.reason
    assert probe.change_state("/simulator", "configure")
    assert probe.change_state("/simulator", "activate")
    assert probe.set_parameter("/simulator", "scene", str(scene)).successful  # as it is
    for name, value in (("scene", str(other)), ("rate", 500.0), ("joints", ["hinge"])):
        result = probe.set_parameter("/simulator", name, value)
        assert not result.successful
        assert f"'{name}' is read-only while the node is configured; clean up" in result.reason
    assert "read-only" in probe.set_parameter("/simulator", "executor", "events").reason
    assert got(probe, "/simulator")["rate"].double_value == 250.0
    for label in ("deactivate", "cleanup"):
        assert probe.change_state("/simulator", label)
    result = probe.set_parameter("/simulator", "scene", str(other))
    assert result.successful, result.reason
    assert probe.change_state("/simulator", "configure")
    request = DescribeParameters.Request(names=["rate"])
    answer = probe.call(DescribeParameters, "/simulator/describe_parameters", request)
    assert "read-only while configured" in answer.descriptors[0].additional_constraints


def test_a_scene_that_is_set_later_is_listened_for(start_node, probe, tmp_path):
    """Its robot comes on a topic; the topic of the scene before is left alone."""
    robot = (ROOT / "config/robots/prosthetic_arm.urdf").read_text(encoding="utf-8")
    scenes = [tmp_path / "first.yaml", tmp_path / "second.yaml"]
    for scene, topic in zip(scenes, ("/one", "/two"), strict=True):
        scene.write_text(f"robot: {{description_topic: {topic}}}\n", encoding="utf-8")
    start_node(arguments=["-p", f"scene:={scenes[0]}"], target=module("inverse_dynamics"))
    probe.wait_health(lambda h: "waiting for the robot description on /one" in h.message)
    name = "/inverse_dynamics"
    assert probe.set_parameter(name, "scene", str(scenes[1])).successful
    assert not probe.change_state(name, "configure")
    probe.wait_health(lambda h: "waiting for the robot description on /two" in h.message)
    probe.spin_until(lambda: not probe.node.count_subscribers("/one"))
    sender = probe.node.create_publisher(String, "/two", LATCHED)
    probe.spin_until(sender.get_subscription_count)
    sender.publish(String(data=robot))
    probe.wait_health(lambda h: h.name == name and h.values.get("state") == "active")
