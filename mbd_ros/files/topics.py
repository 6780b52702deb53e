"""Topics by what they carry: joint states of each robot, odometry of each free body."""

from collections.abc import Collection, Sequence

from mbd_ros.core.model.robot import BASE

JOINT_STATES, ODOMETRY = "joint_states", "odometry"
WORLD = "world"  # frame in which poses of free bodies are given


def joint_state_topic(member: str) -> str:
    """Topic of the joint states of a robot or body of a scene, of the only robot where empty."""
    return f"{member}/{JOINT_STATES}" if member else JOINT_STATES


def odometry_topic(body: str) -> str:
    """Topic of the pose and twist of a free body."""
    return ODOMETRY if body == BASE else f"{body}/{ODOMETRY}"


def beside(topic: str, other: str) -> str:
    """The topic of another message of the same robot: `/a/odometry` beside `/a/joint_states`.

    Args:
        topic: Of the joint states of the only robot.
        other: Relative name.
    """
    return f"{topic.rpartition('/')[0]}/{other}"


def by_member(joints: Sequence[str], members: Collection[str]) -> dict[str, dict[str, str]]:
    """Robot or body -> name of a joint on its topic -> name in the scene.

    Args:
        joints: Names in the scene, such as `left/elbow`.
        members: Names of the robots and bodies among those of the scene.
    """
    found: dict[str, dict[str, str]] = {}
    for joint in joints:
        member, _, own = joint.partition("/")
        pair = (member, own) if member in members else ("", joint)
        found.setdefault(pair[0], {})[pair[1]] = joint
    return found
