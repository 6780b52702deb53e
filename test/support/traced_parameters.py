"""Cases that several tests share: traced parameters."""

MOTOR = {"type": "geared_motor", "joint": "ankle", "ratio": 50.0, "rotor_inertia": 1e-5}


FORCES = [
    {"type": "joint_spring", "joint": "ankle", "stiffness": 30.0, "rest": 0.1, "damping": 0.5},
    {"type": "joint_friction", "joint": "hip_flexion", "coulomb": 0.4, "viscous": 0.05},
    {"type": "applied_wrench", "frame": "foot", "force": [10.0, 0.0, 50.0]},
    {"type": "point_spring", "frame_a": "world", "frame_b": "foot", "stiffness": 200.0},
]
