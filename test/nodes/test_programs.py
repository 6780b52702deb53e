"""The executables as a terminal and ros2 launch treat them: signals at any moment."""

import signal

import pytest
from deadline import until
from nodes.simulation_client import ARM
from places import ROOT

SCENE = ROOT / "config/scenes/controlled_arm.yaml"
NODES = ("inverse_dynamics", "joint_state_projector", "qp_controller", "simulator")


def program(name, *words):
    """Arguments of python that start an executable as its script does."""
    code = f"import sys; from mbd_ros.programs import {name}; sys.exit({name}())"
    return (*words, "-c", code)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("imported", ["numpy.version", "rclpy.node", "mbd_ros.nodes.shell.shell"])
def test_a_signal_while_a_node_still_imports_ends_it_without_a_traceback(
    start_node, imported, number
):
    node = start_node(target=program("qp_controller", "-X", "importtime"))
    node.wait_for(imported)
    assert node.stop(number) == 0, node.log
    assert "Traceback" not in node.log


def test_ctrl_c_while_the_command_line_still_imports_is_130(start_node):
    node = start_node(target=program("mbd_ros", "-X", "importtime"))
    node.wait_for("argparse")
    assert node.stop() == 130, node.log
    assert "Traceback" not in node.log


@pytest.mark.parametrize("name", NODES)
def test_further_signals_while_a_node_ends_change_nothing(start_node, name):
    """A terminal and ros2 launch send two, 50 to 150 ms apart: here they come every 10 ms."""
    node = start_node(arguments=["-p", f"scene:={SCENE}"], target=program(name))
    node.wait_for("]: active")
    until(lambda: node.process.poll() is not None or node.process.send_signal(signal.SIGINT))
    assert node.wait() == 0
    assert "Traceback" not in node.log


def test_a_qp_that_has_solved_leaves_no_leak_lines_at_exit(start_node, probe, tmp_path):
    scene = tmp_path / "arm.yaml"
    scene.write_text(ARM, encoding="utf-8")
    given = ["-p", f"scene:={scene}"]
    slow = ["-p", "rate:=100.0"]
    plant = start_node(arguments=[*given, *slow], target=program("simulator"))
    remap = ["-r", "~/commands:=/simulator/commands"]
    node = start_node(arguments=[*given, *remap], target=program("qp_controller"))
    count = "messages answered in the last second"
    probe.wait_health(lambda h: h.name == "/qp_controller" and h.values.get(count, "0") != "0")
    assert node.stop() == 0
    assert plant.stop() == 0
    assert "nanobind" not in node.log


def test_a_node_takes_the_name_of_an_embedded_scene(start_node, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    start_node(arguments=["-p", "scene:=arm7"], target=program("inverse_dynamics")).wait_for(
        "]: active"
    )
    node = start_node(arguments=["-p", "scene:=arm8"], target=program("joint_state_projector"))
    node.wait_for("no embedded scene of that name; nearest: arm7;")
