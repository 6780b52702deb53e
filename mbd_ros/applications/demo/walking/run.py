"""From muscles to markers and back, as a page: `mbd-ros demo walking`. No topic, no ROS."""

import platform
from collections.abc import Iterator
from importlib.metadata import version
from pathlib import Path

from mbd_ros.applications.demo.choices import WALKING
from mbd_ros.applications.demo.files import KNOWN, PAGE, PICTURE, TABLES
from mbd_ros.applications.demo.folder import replacing_folder
from mbd_ros.applications.demo.moving import moving_result
from mbd_ros.applications.demo.page import Content, page
from mbd_ros.applications.demo.processes import Failed
from mbd_ros.applications.demo.summary import Table, lines
from mbd_ros.applications.demo.walking.numbers import CUTOFF, RESERVE, WalkingNumbers
from mbd_ros.applications.demo.walking.plot import overview, pictures
from mbd_ros.applications.demo.walking.tables import tables
from mbd_ros.applications.demo.walking.task import BURSTS, DURATION, MARKERS, NOISE, STEP

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
        (folder / PICTURE).write_bytes(overview(numbers))
        text = page(_content(numbers, summary, failed))
        (folder / PAGE).write_text(text, encoding="utf-8")
    for table in summary:
        yield from lines(table)
    yield f"\ntables, picture and page: {out}; open {PAGE} there"
    if failed:
        raise Failed("; ".join(failed))


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
        "Versions": ", ".join(f"{name} {version(name)}" for name in _PACKAGES),
        "Machine": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
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
