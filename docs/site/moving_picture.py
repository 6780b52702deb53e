"""Draw the moving picture of the README: `make picture` simulates a leg.

The scene `muscle_leg` swings as in `mbd-ros demo walking`: nine muscles move hip, knee and ankle.
Muscles are as thick and as red as their tension; beside them stand the curves of the largest ones.
"""

import sys
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
import pinocchio as pin
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from mbd_ros.api import Scene
from mbd_ros.applications.demo.walking import DURATION, excitations, marked_leg
from mbd_ros.files.table import Result
from mbd_ros.view.frames import SLACK, TIGHT, Frames
from mbd_ros.view.motion import ViewedMotion, viewed_motion

TARGET = Path(__file__).parents[1] / "images/muscle_leg.gif"
SIZE, DOTS = (6.4, 3.8), 100  # inches, dots an inch
IMAGES_PER_SECOND, REST = 20, 12  # of the picture; images that show the last sample
STEP = 0.006  # s between images
BONE, OUTLINE, BLUE, RED = "#d9cbb0", "#8a7a5c", "#7a9cc6", "#c8202a"
BONES = (("femur", "tibia"), ("tibia", "talus"))
FOOT = (("talus", (0.0, 0.0)), ("calcaneus", (-0.02, 0.0)), ("toes", (0.06, -0.01)))
PELVIS = ((-0.14, 0.02), (-0.065, 0.095), (-0.02, -0.02), (-0.06, -0.08), (-0.126, -0.105))
ORIGIN_OF_PELVIS = (0.0, 1.0)
CURVES = ("iliopsoas", "hamstrings", "tibialis_anterior", "rectus_femoris")


class Drawing(NamedTuple):
    """Artists of the picture that move."""

    muscles: LineCollection
    bones: LineCollection
    outlines: LineCollection
    foot: Any
    cursor: Any


def main() -> None:
    """Simulate, draw and write the picture to the path of the command line or to `docs/images`."""
    scene = marked_leg()
    swing = scene.simulate(DURATION, efforts=excitations(scene), dt=STEP)
    mpl.rcParams["savefig.bbox"] = None
    figure = Figure(SIZE, dpi=DOTS, layout="constrained")
    leg, curves = figure.subplots(1, 2, width_ratios=(1.0, 1.15))
    drawing = prepare(leg, curves, swing)
    frames = Frames(scene)
    motion = viewed_motion(scene, swing, frames.rows)
    update = updater(scene, motion, frames, drawing)
    order = [*range(len(motion.times)), *[len(motion.times) - 1] * REST]
    film = FuncAnimation(figure, update, order, blit=False)
    target = Path(sys.argv[1]) if sys.argv[1:] else TARGET
    film.save(target, PillowWriter(IMAGES_PER_SECOND), dpi=DOTS)


def prepare(leg: Any, curves: Any, swing: Result) -> Drawing:
    """Draw axes and curves, and return the artists that move."""
    leg.set(xlim=(-0.62, 0.5), ylim=(0.0, 1.12), aspect="equal")
    leg.axis("off")
    leg.fill(*np.add(PELVIS, ORIGIN_OF_PELVIS).T, fc=BONE, ec=OUTLINE, lw=1.5, joinstyle="round")
    samples = swing["samples"]
    for name in CURVES:
        curves.plot(samples["time"], samples[f"{name}.tension"], label=name.replace("_", " "))
    curves.set(xlabel="time [s]", ylabel="tension [N]", xlim=(0.0, DURATION))
    curves.legend(frameon=False, fontsize=8, loc="upper center")
    curves.spines[["top", "right"]].set_visible(False)
    outlines = LineCollection([], lw=13, color=OUTLINE, capstyle="round")
    bones = LineCollection([], lw=11, color=BONE, capstyle="round")
    muscles = LineCollection([], capstyle="round")
    for collection in (outlines, bones, muscles):
        leg.add_collection(collection)
    (foot,) = leg.fill([0.0], [0.0], fc=BONE, ec=OUTLINE, lw=1.5, joinstyle="round")
    return Drawing(muscles, bones, outlines, foot, curves.axvline(0.0, color="k", lw=0.8))


def updater(scene: Scene, motion: ViewedMotion, frames: Frames, drawing: Drawing) -> Any:
    """Return the function that draws a sample."""
    assert motion.multipliers is not None  # the scene has no rows
    of: Any = motion.states, motion.accelerations, motion.multipliers
    tensions = np.array([frames.tensions(*each) for each in zip(*of, strict=True)])
    palette = mpl.colors.LinearSegmentedColormap.from_list("tension", (BLUE, RED))
    data = scene.robot.model.createData()

    def draw(row: int) -> None:
        drawn = frames.at(*(values[row] for values in of), most=float(tensions.max()))
        red = np.clip((drawn.colours - SLACK)[:, 2] / (TIGHT - SLACK)[2], 0.0, 1.0)
        drawing.muscles.set(
            segments=drawn.lines[:, :, ::2],
            linewidths=1.5 + 4.5 * red,
            colors=palette(np.sqrt(red)),
        )
        place = placed(scene, data, motion.states[row].q)
        lines = [np.array([place(name, (0.0, 0.0)) for name in ends]) for ends in BONES]
        drawing.bones.set_segments(lines)
        drawing.outlines.set_segments(lines)
        drawing.foot.set_xy(np.array([place(*point) for point in FOOT]))
        drawing.cursor.set_xdata([motion.times[row]] * 2)

    return draw


def placed(scene: Scene, data: Any, q: Any) -> Any:
    """Return a function from a link and a point on it (x, z) to that point in the world (x, z)."""
    model = scene.robot.model
    pin.framesForwardKinematics(model, data, q)

    def place(link: str, point: tuple[float, float]) -> Any:
        oMf = data.oMf[model.getFrameId(link)]
        return oMf.act(np.array([point[0], 0.0, point[1]]))[::2]

    return place


if __name__ == "__main__":
    main()
