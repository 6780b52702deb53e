"""Gaits into files: `mbd-ros gait`."""

from pathlib import Path

from mbd_ros.errors import DataError
from mbd_ros.features.gait.job import Where, run_gait, task_of
from mbd_ros.features.gait.tables import BASIN, BRANCHES, GAITS
from mbd_ros.files.replacing import check_place, refuse_overwriting
from mbd_ros.jobs.lines import Say
from mbd_ros.jobs.result_files import beside, write_tables
from mbd_ros.scene.built_scene import Scene

_PAGES = (".html", ".htm")


def gait_to(
    scene: Scene, task: Path | None, out: Path | None, page: Path | None, say: Say, where: Where
) -> None:
    """Find gaits, and write them where a place is given.

    Args:
        scene: The scene.
        task: Task file; None for a gait near the start of the scene.
        out: The motion of the first gait; its suffix chooses the format.
        page: A page for people.
        say: Is told what was found, a line each.
        where: Where basins are scanned.

    Raises:
        MbdError: As `gait`, or a place that cannot be written to.
    """
    asked = task_of(scene, task)
    if page is not None and page.suffix not in _PAGES:
        raise DataError(f"--page {page}: expected the suffix .html")
    for place in filter(None, (out, page)):
        refuse_overwriting(place, task, scene.path)
    if out is not None:
        for place in (out, *(beside(out, name) for name in (GAITS, BRANCHES, BASIN))):
            check_place(place)
    if page is not None and not page.parent.is_dir():
        raise DataError(f"{page}: directory {page.parent} does not exist")
    result = run_gait(scene, asked, say, where)
    if out is not None:
        write_tables(result, out, say)
    if page is not None:
        from mbd_ros.features.gait.page import write_page

        write_page(
            result, page, "" if asked.continuation is None else asked.continuation.parameter
        )
        say(f"page -> {page}")
