"""Torques of a recorded motion: a bag in, a table out.

With a recording of your own the first step is gone: here a simulation writes the bag.
"""

import mbd_ros as mbd

scene = mbd.load_scene("prosthetic_arm")
raised = scene.with_(initial={"position": {"shoulder_flexion": 0.8, "shoulder_abduction": 0.3}})
raised.simulate(1.0).to_bag("motion")

torques = scene.inverse("motion", derivatives="zero-phase")
torques.to_csv("torques.csv")

for column in torques["samples"].columns:
    if column.name.endswith(".effort"):
        print(f"{column.label}: up to {abs(column.values).max():.3g}")
