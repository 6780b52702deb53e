"""Pictures of the swing: what a laboratory finds, beside what the simulation knows."""

from functools import partial
from typing import Any

import numpy as np

from mbd_ros.applications.demo import panels
from mbd_ros.applications.demo.panels import BLACK, BLUE, ORANGE, Draw, line, name, picture
from mbd_ros.applications.demo.walking.numbers import WalkingNumbers
from mbd_ros.applications.demo.walking.task import JOINTS
from mbd_ros.files.table import MAIN

_FOUND, _TRUE = "from markers", "simulated"


def pictures(numbers: WalkingNumbers) -> dict[str, bytes]:
    """PNG by title."""
    muscles = len(numbers.muscles)
    kinds = {
        "Joint angles": (_draw_angles, len(JOINTS)),
        "Moments of joints": (_draw_moments, len(JOINTS)),
        "Load of the knee": (_draw_load, 3),
        "Residuals": (_draw_residuals, 3),
        "Activations": (_draw_activations, muscles),
        "Muscle forces": (_draw_forces, muscles),
    }
    return {title: picture(partial(draw, numbers), n) for title, (draw, n) in kinds.items()}


def overview(numbers: WalkingNumbers) -> bytes:
    """One PNG with angles, moments and the load of the knee side by side."""
    draws: list[Draw] = [
        partial(draw, numbers) for draw in (_draw_angles, _draw_moments, _draw_load)
    ]
    return panels.overview(draws, len(JOINTS))


def _draw_angles(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    found, true = (r[MAIN][f"{JOINTS[i]}.position"] for r in (numbers.motion, numbers.swing))
    _draw_pair(numbers, panel, np.degrees(found), np.degrees(true))
    name(panel, f"{JOINTS[i]} [deg]")


def _draw_moments(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    found, true = (r[MAIN][f"{JOINTS[i]}.effort"] for r in (numbers.moments, numbers.known))
    _draw_pair(numbers, panel, found, true)
    name(panel, f"{JOINTS[i]} [N·m]")


def _draw_load(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    if i < 2:
        axis, sign, text = ((2, -1.0, "along the shank, pressing"), (0, 1.0, "forwards"))[i]
        found, shared = (numbers.load_of(r) for r in (numbers.forces, numbers.shared))
        to = sign / numbers.weight
        _draw_pair(numbers, panel, to * found[:, axis], to * numbers.load[:, axis])
        line(panel, numbers.time, to * shared[:, axis], ORANGE, "without noise")
    else:
        line(panel, numbers.time, numbers.load_errors(numbers.forces), BLUE, _FOUND)
        line(panel, numbers.time, numbers.load_errors(numbers.shared), ORANGE, "without noise")
        text = "error"
    name(panel, f"{text} [body weights]")


def _draw_residuals(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    seen = numbers.motion["residuals"]
    if i == 0:
        line(panel, numbers.time, 1e3 * seen["rms"], BLUE, "rms")
        line(panel, numbers.time, 1e3 * seen["max"], ORANGE, "largest")
        name(panel, "markers [mm]")
    elif i == 1:
        for joint, values, colour in zip(
            JOINTS, numbers.reserves.T, (BLUE, ORANGE, BLACK), strict=True
        ):
            line(panel, numbers.time, 1e3 * values, colour, joint)
        panel.legend(fontsize=7, ncols=3, frameon=False)
        name(panel, "reserves [mN·m]")
    else:
        values = 1e15 * numbers.forces[MAIN]["muscles.residual"]
        line(panel, numbers.time, values, BLUE, "optimum")
        name(panel, "conditions of the optimum [1e-15]")


def _draw_activations(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    column = f"{numbers.muscles[i]}.activation"
    _draw_pair(numbers, panel, numbers.forces[MAIN][column], numbers.swing[MAIN][column])
    name(panel, numbers.muscles[i].replace("_", " "))


def _draw_forces(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    muscle = numbers.muscles[i]
    found, true = numbers.forces[MAIN][f"{muscle}.force"], numbers.swing[MAIN][f"{muscle}.tension"]
    _draw_pair(numbers, panel, found, true)
    name(panel, f"{muscle.replace('_', ' ')} [N]")


def _draw_pair(numbers: WalkingNumbers, panel: Any, found: Any, true: Any) -> None:
    line(panel, numbers.time, found, BLUE, _FOUND)
    line(panel, numbers.time, true, BLACK, _TRUE, "--")
