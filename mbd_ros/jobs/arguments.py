"""Words that several commands understand, and the file of an error."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from mbd_ros.errors import MbdError, printable
from mbd_ros.scene.schema.locate import scene_word

_ALLOW_CODE = "import the package.module:Class that a scene names; `check` lists them"


def add_scene(parser: argparse.ArgumentParser) -> None:
    """The scene of a command, and the permission to import the code that it names."""
    parser.add_argument(
        "scene", type=scene_word, help="file, or name of an embedded scene (`mbd-ros scenes`)"
    )
    add_allow_code(parser)


def add_allow_code(parser: argparse.ArgumentParser) -> None:
    """The permission to import the code that scenes name; the program acts on it."""
    parser.add_argument("--allow-code", action="store_true", help=_ALLOW_CODE)


def names_scenes(argument: argparse.Action) -> bool:
    """Whether the words of an argument are scenes, of which there are embedded ones."""
    return argument.dest in ("scene", "scenes")


@contextmanager
def about(source: Path | str) -> Iterator[None]:
    """Add the file or option to errors of the core.

    Args:
        source: File or option; errors that name it already pass as they are.
    """
    try:
        yield
    except MbdError as error:
        if printable(str(source)) in str(error):
            raise
        raise type(error)(f"{source}: {error}") from error
