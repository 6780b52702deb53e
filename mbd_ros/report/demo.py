"""A motion of the prosthetic arm through the live node, judged and plotted: `mbd-ros demo`."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from mbd_ros.bags import BagWriter, new_message
from mbd_ros.core.inverse_dynamics import Torques
from mbd_ros.core.state import Array, Motion
from mbd_ros.recordings import read_motion
from mbd_ros.replay import CONSTRAINT_FORCES, JOINT_STATE, TORQUES, Replay, play
from mbd_ros.report.torque_errors import compare
from mbd_ros.report.torque_plot import plot_torques
from mbd_ros.scene import Scene, load_scene
from msg_adapters.joint_state import write_joint_state

SCENE = "package://mbd_ros/config/scenes/prosthetic_arm.yaml"
EXACT = "/exact_torques"
_RATE, _SECONDS, _CUTOFF, _SKIP = 200, 6.0, 20.0, 0.2  # Hz, s, Hz, s
_BEGIN = 1_000_000_000_000  # ns: a clock that shows 0 is one that never ran


def demo(folder: Path) -> Iterator[str]:
    """Run the demo.

    Args:
        folder: Where bags and plot go; created.

    Yields:
        What happens, then the error table.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scene = load_scene(SCENE)
    recorded, answered, plot = folder / "motion", folder / "torques", folder / "torques.png"
    motion, exact = _reaching(scene)
    _record(recorded, scene, motion, exact)
    yield f"recorded {len(motion.stamps)} joint states of {scene.robot.name} in {recorded}"
    played, heard = play(Replay(recorded, scene.path, answered, 1.0, "/joint_states", _CUTOFF))
    yield f"replayed through the live node: {played} played, {heard} answered -> {answered}"
    joints = scene.couplings.independent
    yield from compare((answered, TORQUES), (recorded, EXACT), joints, _SKIP)
    live = read_motion(answered, joints, topic=TORQUES).motion
    forces = read_motion(answered, scene.couplings.dependent, topic=CONSTRAINT_FORCES).motion
    plot_torques(plot, scene.robot, live, forces, (motion.stamps, exact.tau))
    yield f"torques and coupling force plotted in {plot}"


def _reaching(scene: Scene) -> tuple[Motion, Torques]:
    """A smooth motion within the limits of the independent joints, and its exact torques."""
    joints = [scene.robot.joint(name) for name in scene.couplings.independent]
    middle = np.array([(j.lower + j.upper) / 2 for j in joints])
    reach = np.array([0.4 * (j.upper - j.lower) for j in joints])
    t = np.arange(int(_RATE * _SECONDS))[:, None] / _RATE
    w = 2 * np.pi * (0.3 + 0.1 * np.arange(len(joints)))
    position = middle + reach * np.sin(w * t)
    velocity, acceleration = reach * w * np.cos(w * t), -reach * w**2 * np.sin(w * t)
    exact = scene.inverse_dynamics().batch(position, velocity, acceleration)
    stamps = _BEGIN + np.round(t[:, 0] * 1e9).astype(np.int64)
    return Motion(scene.couplings.independent, stamps, position, velocity, acceleration), exact


def _record(path: Path, scene: Scene, motion: Motion, exact: Torques) -> None:
    assert motion.velocity is not None
    rows = zip(motion.stamps.tolist(), motion.position, motion.velocity, exact.tau, strict=True)
    with BagWriter(path) as bag:
        for stamp, position, velocity, effort in rows:
            _write(bag, "/joint_states", stamp, scene, position=position, velocity=velocity)
            _write(bag, EXACT, stamp, scene, position=position, effort=effort)


def _write(bag: BagWriter, topic: str, stamp: int, scene: Scene, **values: Array) -> None:
    names = scene.couplings.independent
    message = write_joint_state(new_message(JOINT_STATE), stamp, names, **values)
    bag.write(topic, JOINT_STATE, stamp, message)
