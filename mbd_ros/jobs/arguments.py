"""Arguments that several commands share, and the file that an error names."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mbd_ros.errors import MbdError, printable
from mbd_ros.scene.schema.locate import scene_word

_ALLOW_CODE = (
    "Import the code that a scene names as package.module:Class; `mbd-ros check` lists it."
)


def add_scene(parser: argparse.ArgumentParser) -> None:
    """Declare the scene, and the permission to import the code that it names."""
    parser.add_argument(
        "scene",
        type=scene_word,
        help="Scene file, or name of an embedded scene (`mbd-ros scenes` lists them).",
    )
    add_allow_code(parser)


def add_allow_code(parser: argparse.ArgumentParser) -> None:
    """Declare the permission to import the code that scenes name; `cli` evaluates it."""
    parser.add_argument("--allow-code", action="store_true", help=_ALLOW_CODE)


def names_scenes(argument: argparse.Action) -> bool:
    """Return whether an argument takes scenes, of which some are embedded."""
    return argument.dest in ("scene", "scenes")


@contextmanager
def about(source: Path | str) -> Iterator[None]:
    """Put the name of a file or option in front of the errors that are raised inside.

    Args:
        source: File or option. Errors that name it already remain as they are.
    """
    try:
        yield
    except MbdError as error:
        if printable(str(source)) in str(error):
            raise
        raise type(error)(f"{source}: {error}") from error
