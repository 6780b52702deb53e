"""A knee that is a four-bar: a loop, closed by constraint forces."""

import mbd_ros as mbd

leg = mbd.load_scene("controlled_four_bar")
print(leg)

swing = leg.simulate(0.5)
table = swing["samples"]
forces = [name for name in table if ".force" in name or ".torque" in name]
print("constraint forces:", *forces)
print(f"largest violation of the loop: {table['drift.position'].max():.1e} m")

torques = leg.inverse(swing)
torques.plot("knee.png")
