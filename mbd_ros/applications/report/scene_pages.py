"""Pages beside a report that show its scenes as they move."""

from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

from mbd_ros.applications.report.subjects import Subject
from mbd_ros.errors import DataError, MbdError
from mbd_ros.features.simulation.job import Interrupted, simulate
from mbd_ros.files.replacing import replacing
from mbd_ros.scene.reader import load_scene
from mbd_ros.view.frames import Frames
from mbd_ros.view.motion import viewed_motion
from mbd_ros.view.recording import animated_page

FOLDER = "scenes"
_LONGEST = 2.0  # s that a page shows


def scene_pages(subjects: Sequence[Subject], folder: Path, made: dict[str, str]) -> Iterator[str]:
    """Write a page for each scene that runs.

    Args:
        subjects: The scenes.
        folder: Of the report.
        made: Is filled in: name of a scene -> its page, relative to the folder.

    Yields:
        What is left out, a line each.
    """
    if not subjects:
        return
    if find_spec("viser") is None:
        yield "no pages of scenes: pip install 'mbd_ros[view]'"
        return
    (folder / FOLDER).mkdir(parents=True, exist_ok=True)
    for subject in subjects:
        try:
            text = _page(subject)
        except Interrupted:
            raise
        except MbdError as error:
            yield f"no page of {subject.name}: {error}"
            continue
        made[subject.name] = f"{FOLDER}/{subject.name}.html"
        with replacing(folder / made[subject.name]) as file:
            file.write(text.encode())


def _page(subject: Subject) -> str:
    scene = load_scene(subject.path)
    if not scene.robot.model.nv:
        raise DataError("nothing moves")
    result = simulate(scene, min(subject.times[-1], _LONGEST))
    motion = viewed_motion(scene, result, Frames(scene).rows)
    return animated_page(scene, motion, subject.name).text
