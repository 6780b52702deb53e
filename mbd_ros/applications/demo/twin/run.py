"""A press and its twin, as a page: `mbd-ros demo twin`. No topic, no ROS."""

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from mbd_ros.applications.demo import panels
from mbd_ros.applications.demo.files import KNOWN, TWIN_TABLE, replacing_folder
from mbd_ros.applications.demo.page import Content, conclusion, machine, moving_result, write_page
from mbd_ros.applications.demo.panels import BLACK, BLUE, ORANGE, line, name, picture
from mbd_ros.applications.demo.summary import Table, check_table
from mbd_ros.applications.demo.task import TWIN
from mbd_ros.applications.demo.twin.numbers import (
    DURATION,
    FAULT,
    HYPOTHESES,
    NAMED,
    STEP,
    WINDOW,
    TwinNumbers,
)
from mbd_ros.files.table import MAIN, Result

_CLOSURE = "rocker_loop_closure.x"
TITLE, _SLOWER = "Demo: a press and its twin", 2.0


def twin(out: Path) -> Iterator[str]:
    """Simulate the press, follow it, write page, picture and table.

    Args:
        out: Folder, see `replacing_folder`.

    Yields:
        What happens, then the summary.

    Raises:
        DataError: A place that is not accepted.
        Failed: A check is not met; the page is kept.
    """
    with replacing_folder(out, KNOWN) as folder:
        yield f"{TWIN} ..."
        numbers = TwinNumbers()
        checks = numbers.checks()
        summary = [_faults(numbers), check_table(checks)]
        failed = [f"{c.what}: {c.found}" for c in checks if not c.is_met]
        _samples(numbers).to(folder / f"{TWIN_TABLE}.csv")
        content = _content(numbers, summary, failed)
        write_page(folder, overview(numbers), content)
    yield from conclusion(content, "table", out)


def _faults(numbers: TwinNumbers) -> Table:
    rows = []
    for run in numbers.runs:
        said = [f"{what} at {t:.2f} s" for t, what in run.named if what]
        late = numbers.delay(run)
        rows.append((run.fault or "none", "; ".join(said) or "-", f"{late:.2f}" if late else "-"))
    heads = ("planted fault", "what the twin says", "after [s]")
    return Table(f"Faults, planted at {FAULT:g} s", heads, rows)


def _samples(numbers: TwinNumbers) -> Result:
    return Result({MAIN: numbers.runs[-1].samples}, {"job": "demo"})


def _content(numbers: TwinNumbers, summary: list[Table], failed: list[str]) -> Content:
    noise = numbers.scene.sensors[0].noise  # type: ignore[attr-defined]
    text = [
        "A motor turns the crank of a four-bar; its rocker works against a spring and friction of "
        f"its bearing. One encoder sees the crank, with noise of {1e3 * noise:g} mrad, and the "
        "torque of the motor is known. The twin, an extended Kalman filter on the loop, finds all "
        "other joints and the forces in the loop.",
        "What moves the press and is not in the model is estimated as an effort on the joint that "
        "shows it best. Each hypothesis says which effort would be lacking if it were true; over "
        f"the last {WINDOW:g} s the twin compares, and names what explains the lacking effort.",
    ]
    made = {
        "Hypotheses": "; ".join(
            f"{name}: {', '.join(f'{k} = {v:g}' for k, v in numbers_.items())}"
            for name, numbers_ in HYPOTHESES.items()
        ),
        "Accepted": f"a fault is named within {NAMED:g} s",
        **machine(("numpy", "pin")),
    }
    moves = moving_result(numbers.scene, _samples(numbers), TITLE, _SLOWER)
    caption = f"The press with the last fault, {_SLOWER:g} times slower."
    facts = f"{len(numbers.runs)} runs of {DURATION:g} s, {1 / STEP:g} samples a second."
    shown = pictures(numbers)
    return Content(TITLE, facts, failed, text, (moves, caption), shown, summary, made)


def pictures(numbers: TwinNumbers) -> dict[str, bytes]:
    """PNG by title."""
    return {
        "What nothing measures": picture(partial(_draw_sound, numbers), 3),
        "What the model lacks": picture(partial(_draw_lacking, numbers), 1 + len(HYPOTHESES)),
    }


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


def overview(numbers: TwinNumbers) -> bytes:
    """One PNG with both side by side."""
    return panels.overview([partial(_draw_sound, numbers), partial(_draw_lacking, numbers)], 3)
