"""The scenes that this package brings: `mbd-ros scenes`."""

import argparse
from itertools import takewhile
from pathlib import Path

from mbd_ros.errors import OK, SceneError
from mbd_ros.jobs.progress import say
from mbd_ros.scene.schema.locate import embedded_scenes


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """`scenes` understands no words of its own."""


def run(arguments: argparse.Namespace) -> int:
    """Print the names of the scenes with a line each; the exit code.

    Raises:
        SceneError: The files of the package are not installed.
    """
    scenes = embedded_scenes()
    if not scenes:
        raise SceneError("the scenes of this package are not installed beside it")
    width = max(map(len, scenes))
    for name, path in scenes.items():
        say(f"{name:<{width}}  {about_scene(path)}")
    return OK


def about_scene(path: Path) -> str:
    """The first sentence of the comment at the top of a scene file."""
    with path.open(encoding="utf-8") as lines:
        comment = takewhile(lambda line: line.startswith("#"), lines)
        text = " ".join(line.lstrip("#").strip() for line in comment)
    return text.partition(". ")[0].rstrip(".")
