"""Stress in the pylon of a leg prosthesis while the leg rolls over its foot, by CalculiX."""

import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib
import numpy as np

import mbd_ros as mbd
from mbd_ros.features.loads.fem.mesh import tube, write_mesh

matplotlib.use("Agg")
INNER, OUTER, LENGTH, ANKLE = 0.0125, 0.015, 0.36, -0.40  # m; z of the lower end in the shank
SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 0.3
TIMES = np.arange(0.02, SECONDS, 0.02)


def stresses(path):
    """Von Mises stress of every node in every step [MPa], from a .frd file."""
    steps, reads = [], False
    for line in path.read_text().splitlines():
        if line.startswith(" -4"):
            reads = "STRESS" in line
            if reads:
                steps.append([])
        elif reads and line.startswith(" -1"):
            xx, yy, zz, xy, yz, zx = (float(line[13 + 12 * i : 25 + 12 * i]) for i in range(6))
            normal = (xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2
            steps[-1].append(np.sqrt(0.5 * normal + 3.0 * (xy**2 + yz**2 + zx**2)))
    return np.array(steps)


def draw(times, stress, mesh, out):
    """The largest stress over time, and that on the tube, unrolled, when it is largest."""
    from matplotlib import pyplot

    picture, (left, right) = pyplot.subplots(1, 2, figsize=(10.0, 4.0), layout="constrained")
    left.plot(times, stress.max(axis=1), marker="o")
    left.set(xlabel="time [s]", ylabel="largest von Mises stress [MPa]")
    worst = int(stress.max(axis=1).argmax())
    points = mesh.points
    outside = np.hypot(points[:, 0], points[:, 1]) > 0.999 * OUTER
    angle = np.degrees(np.arctan2(points[outside, 1], points[outside, 0]))
    shown = right.scatter(angle, 1e3 * points[outside, 2], c=stress[worst, outside], s=60)
    right.set(xlabel="angle [deg], 0 ahead", ylabel="height [mm]", title=f"{times[worst]:.2f} s")
    picture.colorbar(shown, label="von Mises stress [MPa]")
    picture.savefig(out)


scene = mbd.load_scene("prosthetic_leg_roll_over")
scene.simulate(SECONDS).to("step.csv")
mesh = tube(INNER, OUTER, LENGTH, (1, 16, 8))
write_mesh(mesh, Path("tube.inp"), 1000.0)
words = ["loads", "prosthetic_leg_roll_over", "step.csv", "--body", "shank", "--units", "mm"]
words += ["--mesh", "tube.inp", "--mesh-pose", "0", "0", str(1e3 * ANKLE), "0", "0", "0"]
words += ["--attach", "knee=top", "ankle=bottom", "--density", "2.7e-9", "--young", "70e3"]
words += ["--poisson", "0.33", "--at", *map(str, TIMES), "-o", "pylon.inp"]
subprocess.run([sys.executable, "-m", "mbd_ros", *words], check=True)
if shutil.which("ccx") is None:
    print("CalculiX is not installed (apt-get install calculix-ccx): pylon.inp waits for it")
else:
    subprocess.run(["ccx", "pylon"], check=True, capture_output=True)
    stress = stresses(Path("pylon.frd"))[:, : len(mesh.points)]
    lines = Path("pylon.inp").read_text().splitlines()
    times = [float(line.split()[3]) for line in lines if line.startswith("** t = ")]
    draw(np.array(times), stress, mesh, "pylon.png")
    print(f"largest stress: {stress.max():.1f} MPa -> pylon.png")
