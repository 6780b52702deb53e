"""The nodes of this package, a line each; `setup.py` makes an executable of every line."""

NODES = {
    "digital_twin": "mbd_ros.nodes.state_estimator.digital_twin.node:DigitalTwinNode",
    "inverse_dynamics": "mbd_ros.nodes.inverse_dynamics.node:InverseDynamicsNode",
    "joint_state_projector": "mbd_ros.nodes.joint_state_projector.node:JointStateProjectorNode",
    "marker_kinematics": "mbd_ros.nodes.marker_kinematics.node:MarkerKinematicsNode",
    "muscle_forces": "mbd_ros.nodes.inverse_dynamics.muscle_forces.node:MuscleForcesNode",
    "payload_estimator": "mbd_ros.nodes.payload_estimator.node:PayloadEstimatorNode",
    "qp_controller": "mbd_ros.nodes.controller.node:QpControllerNode",
    "reference_player": "mbd_ros.nodes.reference_player.node:ReferencePlayer",
    "simulator": "mbd_ros.nodes.simulator.node:SimulatorNode",
    "sliding_mode_controller": "mbd_ros.nodes.controller.node:SlidingModeControllerNode",
    "state_estimator": "mbd_ros.nodes.state_estimator.node:StateEstimatorNode",
    "web_view": "mbd_ros.nodes.web_view.node:WebViewNode",
}
