"""Stress in the pylon of a leg prosthesis while the leg rolls over its foot, by CalculiX."""

import shutil
import subprocess
import sys
from pathlib import Path

import matplotlib
import meshio
import numpy as np

import mbd_ros as mbd

matplotlib.use("Agg")
INNER, OUTER, LENGTH, ANKLE = 0.0125, 0.015, 0.36, -0.40  # m; z of the lower end in the shank
SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 0.3
TIMES = np.arange(0.02, SECONDS, 0.02)


def tube(through, around, along):
    """A tube of 20-node bricks along z, and its nodes at both ends by the names of their sets."""
    corners = np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0)])
    corners = np.vstack((corners, corners + np.array((0, 0, 2))))
    ring = [(0, 1), (1, 2), (2, 3), (3, 0)]
    edges = [*ring, *((a + 4, b + 4) for a, b in ring), *((i, i + 4) for i in range(4))]
    brick = np.vstack((corners, [(corners[a] + corners[b]) // 2 for a, b in edges]))
    first = 2 * np.stack(np.meshgrid(range(through), range(around), range(along)), -1)
    at = first.reshape(-1, 1, 3) + brick
    at[..., 1] %= 2 * around  # the last brick meets the first
    grid, cells = np.unique(at.reshape(-1, 3), axis=0, return_inverse=True)
    radius = INNER + (OUTER - INNER) * grid[:, 0] / (2 * through)
    angle = np.pi * grid[:, 1] / around
    height = LENGTH * grid[:, 2] / (2 * along)
    points = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), height))
    ends = {"bottom": grid[:, 2] == 0, "top": grid[:, 2] == 2 * along}
    sets = {name: np.flatnonzero(there).tolist() for name, there in ends.items()}
    return points, cells.reshape(-1, 20), sets


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


def draw(times, stress, points, out):
    """The largest stress over time, and that on the tube, unrolled, when it is largest."""
    from matplotlib import pyplot

    picture, (left, right) = pyplot.subplots(1, 2, figsize=(10.0, 4.0), layout="constrained")
    left.plot(times, stress.max(axis=1), marker="o")
    left.set(xlabel="time [s]", ylabel="largest von Mises stress [MPa]")
    worst = int(stress.max(axis=1).argmax())
    outside = np.hypot(points[:, 0], points[:, 1]) > 0.999 * OUTER
    angle = np.degrees(np.arctan2(points[outside, 1], points[outside, 0]))
    shown = right.scatter(angle, 1e3 * points[outside, 2], c=stress[worst, outside], s=60)
    right.set(xlabel="angle [deg], 0 ahead", ylabel="height [mm]", title=f"{times[worst]:.2f} s")
    picture.colorbar(shown, label="von Mises stress [MPa]")
    picture.savefig(out)


scene = mbd.load_scene("prosthetic_leg_roll_over")
scene.simulate(SECONDS).to("step.csv")
points, cells, sets = tube(1, 16, 8)
meshio.Mesh(1e3 * points, {"hexahedron20": cells}, point_sets=sets).write("tube.inp")
words = ["loads", "prosthetic_leg_roll_over", "step.csv", "--body", "shank", "--units", "mm"]
words += ["--mesh", "tube.inp", "--mesh-pose", "0", "0", str(1e3 * ANKLE), "0", "0", "0"]
words += ["--attach", "knee=top", "ankle=bottom", "--density", "2.7e-9", "--young", "70e3"]
words += ["--poisson", "0.33", "--at", *map(str, TIMES), "-o", "pylon.inp"]
subprocess.run([sys.executable, "-m", "mbd_ros", *words], check=True)
if shutil.which("ccx") is None:
    print("CalculiX is not installed (apt-get install calculix-ccx): pylon.inp waits for it")
else:
    subprocess.run(["ccx", "pylon"], check=True, capture_output=True)
    stress = stresses(Path("pylon.frd"))[:, : len(points)]
    lines = Path("pylon.inp").read_text().splitlines()
    times = [float(line.split()[3]) for line in lines if line.startswith("** t = ")]
    draw(np.array(times), stress, points, "pylon.png")
    print(f"largest stress: {stress.max():.1f} MPa -> pylon.png")
