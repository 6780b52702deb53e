"""The command `mbd-ros scenes`: the scenes of this package."""

import argparse
from itertools import takewhile
from pathlib import Path

from mbd_ros.errors import OK, SceneError
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import embedded_scenes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare no arguments."""


def run(arguments: argparse.Namespace) -> int:
    """Print the name of each scene with its first sentence, and return the exit code.

    Raises:
        SceneError: The files of the package are not installed.
    """
    scenes = embedded_scenes()
    if not scenes:
        raise SceneError(
            "the scenes of this package are not installed; install the package again, or give a "
            "scene file"
        )
    width = max(map(len, scenes))
    for name, path in scenes.items():
        say(f"{name:<{width}}  {about_scene(path)}")
    return OK


def about_scene(path: Path) -> str:
    """Return the first sentence of the comment at the top of a scene file."""
    with path.open(encoding="utf-8") as lines:
        comment = takewhile(lambda line: line.startswith("#"), lines)
        text = " ".join(line.lstrip("#").strip() for line in comment)
    return text.partition(". ")[0].rstrip(".")
