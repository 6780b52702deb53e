"""What a tendon that couples two joints changes: motors that are spared, and what it carries."""

import mbd_ros as mbd

arm = mbd.load_scene("prosthetic_arm")  # the elbow follows the shoulder
free = arm.with_(couplings=None)  # the same arm without the tendon
print("independent joints:", *arm.couplings.independent)
print("without the tendon:", *free.couplings.independent)

raised = arm.with_(initial={"position": {"shoulder_flexion": 0.8}})
motion = raised.simulate(1.0, dt=0.01)
with_tendon, without = arm.inverse(motion)["samples"], free.inverse(motion)["samples"]
print(f"the tendon carries up to {abs(with_tendon['elbow.multiplier']).max():.2g} N m")
print(f"a motor would have to give {abs(without['elbow.effort']).max():.2g} N m")
