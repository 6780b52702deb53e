"""Real nodes over DDS: each test starts processes on the session's own domain."""

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from places import ROOT

pytest.importorskip("rclpy")

from nodes.node_process import PROFILES, NodeProcess
from nodes.probe import Probe

from mbd_ros.jobs.domain_claim import claimed_domain

MINIMAL = ROOT / "test/support/nodes/minimal_node.py"
os.environ[PROFILES] = str(ROOT / "test/support/nodes/quick_acks.xml")  # read once, at first use
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"


@pytest.fixture(autouse=True)
def no_node_crashes() -> Iterator[None]:
    """A node that dies of a signal such as SIGSEGV fails its test, which shows its stack."""
    yield
    started = NodeProcess.started
    crashed = [text for node in started if (text := node.crash())]
    started[:] = [node for node in started if node.process.poll() is None]
    assert not crashed, "\n".join(crashed)


@pytest.fixture(scope="session")
def domain() -> Iterator[int]:
    """A domain id that is this session's own on this machine."""
    with claimed_domain() as own:
        yield own


@pytest.fixture
def probe(domain: int) -> Iterator[Probe]:
    """The test's own node."""
    with Probe(domain) as node:
        yield node


@pytest.fixture
def start_node(domain: int, tmp_path: Path) -> Iterator[Callable[..., NodeProcess]]:
    """Start `python target --ros-args --params-file ...`; what still runs is killed at the end.

    Args of the function: `parameters` (YAML of a file), `arguments` (more ROS arguments), and
    `target` (arguments of python; default the minimal node).
    """
    started: list[NodeProcess] = []

    def start(
        parameters: str = "",
        arguments: Sequence[str] = (),
        target: Sequence[str] = (str(MINIMAL),),
    ) -> NodeProcess:
        command = [sys.executable, *target, "--ros-args", *arguments]
        if parameters:
            file = tmp_path / f"parameters_{len(started)}.yaml"
            file.write_text(parameters)
            command += ["--params-file", str(file)]
        started.append(NodeProcess(command, domain))
        return started[-1]

    yield start
    for node in started:
        if node.process.poll() is None:
            node.process.kill()
            node.wait()
