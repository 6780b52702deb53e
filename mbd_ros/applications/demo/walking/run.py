"""From muscles to markers and back, as a page: `mbd-ros demo walking`. No topic, no ROS."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mbd_ros.applications.demo import panels
from mbd_ros.applications.demo.files import KNOWN, TABLES, replacing_folder
from mbd_ros.applications.demo.page import Content, conclusion, machine, moving_result, write_page
from mbd_ros.applications.demo.panels import BLACK, BLUE, ORANGE, Draw, line, name, picture
from mbd_ros.applications.demo.summary import Table
from mbd_ros.applications.demo.task import WALKING
from mbd_ros.applications.demo.walking.numbers import CUTOFF, RESERVE, WalkingNumbers, tables
from mbd_ros.applications.demo.walking.task import BURSTS, DURATION, JOINTS, MARKERS, NOISE, STEP
from mbd_ros.files.table import MAIN

_FOUND, _TRUE = "from markers", "simulated"
_SLOWER = 8.0  # than life: 0.4 s are too short to be seen
_PACKAGES = ("numpy", "pin", "scipy")


def walking(out: Path) -> Iterator[str]:
    """Simulate the swing, analyse its markers, write page, picture and tables.

    Args:
        out: Folder, see `replacing_folder`.

    Yields:
        What happens, then the summary.

    Raises:
        DataError: A place that is not accepted.
        Failed: A check is not met; the page is kept.
    """
    with replacing_folder(out, KNOWN) as folder:
        yield f"{WALKING} ..."
        numbers = WalkingNumbers()
        summary = tables(numbers)
        failed = [f"{c.what}: {c.found}" for c in numbers.checks() if not c.is_met]
        for name in TABLES:
            getattr(numbers, name).to(folder / f"{name}.csv")
        content = _content(numbers, summary, failed)
        write_page(folder, overview(numbers), content)
    yield from conclusion(content, "tables", out)


def _content(numbers: WalkingNumbers, summary: list[Table], failed: list[str]) -> Content:
    text = [
        "Bursts of excitation move a leg of nine muscles with elastic tendons, from the moment at "
        "which the toes leave the ground. The pelvis rests and nothing touches the foot: this is "
        "the swing alone, not stance, in which the knee carries several body weights.",
        f"Cameras see {len(MARKERS)} markers at {1 / STEP:g} Hz with noise of {1e3 * NOISE:g} mm. "
        "From them come the angles (marker kinematics), the moments (inverse dynamics behind a "
        f"low-pass of {CUTOFF:g} Hz), muscle forces (least sum of squared activations) and the "
        "load of the knee, each beside what the simulation knows.",
        "The optimum knows neither which muscles were excited, nor passive forces, nor that "
        "tendons give way: forces of muscles differ from the simulated ones also where the "
        "motion is exact (without noise).",
    ]
    made = {
        "Excitations": ", ".join(
            f"{b.muscle} {b.excitation:g} ({b.begin:g} to {b.end:g} s)" for b in BURSTS
        ),
        "Static optimisation": f"squares of activations, reserves of {RESERVE:g} N·m",
        "Load of the knee": "force on the shank, in its axes, with all muscles",
        **machine(_PACKAGES),
    }
    moving = moving_result(numbers.scene, numbers.swing, WALKING, _SLOWER)
    moves = (
        moving,
        f"The simulated swing, {_SLOWER:g} times slower; muscles are red at the largest tension.",
    )
    facts = f"{DURATION:g} s of simulated time, {len(numbers.time)} frames."
    return Content(
        f"Demo: {WALKING}", facts, failed, text, moves, pictures(numbers), summary, made
    )


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


def _draw_angles(numbers: WalkingNumbers, panel: Any, i: int) -> None:
    found, true = (r[MAIN][f"{JOINTS[i]}.position"] for r in (numbers.motion, numbers.swing))
    _draw_pair(numbers, panel, np.degrees(found), np.degrees(true))
    name(panel, f"{JOINTS[i]} [deg]")


def _draw_pair(numbers: WalkingNumbers, panel: Any, found: Any, true: Any) -> None:
    line(panel, numbers.time, found, BLUE, _FOUND)
    line(panel, numbers.time, true, BLACK, _TRUE, "--")


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


def overview(numbers: WalkingNumbers) -> bytes:
    """One PNG with angles, moments and the load of the knee side by side."""
    draws: list[Draw] = [
        partial(draw, numbers) for draw in (_draw_angles, _draw_moments, _draw_load)
    ]
    return panels.overview(draws, len(JOINTS))
