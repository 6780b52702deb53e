"""Processes that the pages start side by side: they come up, and the last one answers."""

import shlex

import pytest
from page_blocks import blocks, commands, task_pages
from sensor_msgs.msg import JointState

from mbd_ros.nodes.table import NODES

STARTED = [
    (page, lines)
    for page in task_pages()
    for lines in (commands(block) for block in blocks(page) if block.kind == "bash")
    if lines and all(line.split()[0] in NODES for line in lines)
]


ANSWERS = {"my_prosthesis.md": "/inverse_dynamics/joint_torques"}


def test_a_page_starts_nodes():
    assert ANSWERS.keys() <= {page.name for page, _ in STARTED}


@pytest.mark.parametrize(("page", "lines"), STARTED, ids=lambda given: getattr(given, "name", ""))
def test_nodes_of_a_page_work_together(page, lines, probe, start_node):
    heard = []
    if page.name in ANSWERS:
        probe.node.create_subscription(JointState, ANSWERS[page.name], heard.append, 10)
    for line in lines:
        name, begin, *words = shlex.split(line)
        assert begin == "--ros-args"
        start_node("", words, ("-m", "mbd_ros.nodes", name)).wait_for("active")
    if page.name in ANSWERS:
        probe.spin_until(lambda: heard)
        assert {"hip_flexion", "knee", "ankle"} <= set(heard[0].name)
        assert max(map(abs, heard[0].effort)) > 0.01
