"""Topics of a demo, and their publishers."""

SIMULATOR, WATCHER = "/simulator", "/inverse_dynamics"
STATES, CLOCK, DIAGNOSTICS = "/joint_states", "/clock", "/diagnostics"
FORCES, COMMANDS = f"{SIMULATOR}/constraint_forces", f"{SIMULATOR}/commands"
TORQUES, COUPLING = f"{WATCHER}/joint_torques", f"{WATCHER}/constraint_forces"
_JOINT_STATE = "sensor_msgs/msg/JointState"


def loop_state(controller: str) -> str:
    """Topic of the tracking error of a controller."""
    return f"{controller}/state"


def reference(controller: str) -> str:
    """Topic of the reference of a controller."""
    return f"{controller}/joint_trajectory"


def recorded(controller: str, has_rows: bool, has_coupling: bool) -> dict[str, str]:
    """The recorded topics: name -> type.

    Args:
        controller: Fully qualified name of the node.
        has_rows: Whether the plant has constraint rows.
        has_coupling: Whether it has dependent joints.
    """
    optional = {FORCES: has_rows, COUPLING: has_coupling}
    return {
        STATES: _JOINT_STATE,
        COMMANDS: "std_msgs/msg/Float64MultiArray",
        loop_state(controller): _JOINT_STATE,
        reference(controller): "trajectory_msgs/msg/JointTrajectory",
        TORQUES: _JOINT_STATE,
        **{topic: _JOINT_STATE for topic, is_there in optional.items() if is_there},
        DIAGNOSTICS: "diagnostic_msgs/msg/DiagnosticArray",
        CLOCK: "rosgraph_msgs/msg/Clock",
    }
