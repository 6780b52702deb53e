"""The nodes of this package, a line each; `setup.py` makes an executable of every line."""

NODES = {
    "inverse_dynamics": "mbd_ros.nodes.inverse_dynamics:InverseDynamicsNode",
    "joint_state_projector": "mbd_ros.nodes.joint_state_projector:JointStateProjectorNode",
    "qp_controller": "mbd_ros.nodes.qp_controller:QpControllerNode",
    "reference_player": "mbd_ros.nodes.reference_player:ReferencePlayer",
    "simulator": "mbd_ros.nodes.simulator:SimulatorNode",
    "sliding_mode_controller": "mbd_ros.nodes.sliding_mode_controller:SlidingModeControllerNode",
}
