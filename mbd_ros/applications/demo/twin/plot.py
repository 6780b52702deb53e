"""Pictures of the press and its twin."""

from functools import partial
from typing import Any

from mbd_ros.applications.demo import panels
from mbd_ros.applications.demo.panels import BLACK, BLUE, ORANGE, line, name, picture
from mbd_ros.applications.demo.twin.numbers import FAULT, HYPOTHESES, TwinNumbers

_CLOSURE = "rocker_loop_closure.x"


def pictures(numbers: TwinNumbers) -> dict[str, bytes]:
    """PNG by title."""
    return {
        "What nothing measures": picture(partial(_draw_sound, numbers), 3),
        "What the model lacks": picture(partial(_draw_lacking, numbers), 1 + len(HYPOTHESES)),
    }


def overview(numbers: TwinNumbers) -> bytes:
    """One PNG with both side by side."""
    return panels.overview([partial(_draw_sound, numbers), partial(_draw_lacking, numbers)], 3)


def _draw_sound(numbers: TwinNumbers, panel: Any, i: int) -> None:
    samples = numbers.runs[0].samples
    true, found, text = (
        ("rocker.position", "rocker.estimate", "rocker [rad]"),
        ("coupler.position", "coupler.estimate", "coupler [rad]"),
        (_CLOSURE, f"{_CLOSURE}_estimate", "force of the closure, x [N]"),
    )[i]
    line(panel, samples["time"], samples[true], BLACK, "press")
    line(panel, samples["time"], samples[found], BLUE, "twin", "--")
    name(panel, text)
    panel.legend(fontsize=7, loc="upper right")


def _draw_lacking(numbers: TwinNumbers, panel: Any, i: int) -> None:
    run = numbers.runs[i]
    line(panel, run.samples["time"], run.samples["unknown_effort"], BLUE, "unknown effort")
    name(panel, f"{run.fault or 'no fault'}: unknown effort [N·m]")
    if run.fault:
        panel.axvline(FAULT, color=BLACK, lw=0.8)
    for t, what in run.named:
        if what:
            panel.axvline(t, color=ORANGE, lw=1.0)
