"""Words that several commands understand."""

import argparse

from mbd_ros.scene.schema.locate import scene_word

_ALLOW_CODE = "import the package.module:Class that a scene names; `check` lists them"


def add_scene(parser: argparse.ArgumentParser) -> None:
    """The scene of a command, and the permission to import the code that it names."""
    parser.add_argument(
        "scene", type=scene_word, help="file, or name of an embedded scene (`mbd-ros scenes`)"
    )
    add_allow_code(parser)


def names_scenes(argument: argparse.Action) -> bool:
    """Whether the words of an argument are scenes, of which there are embedded ones."""
    return argument.dest in ("scene", "scenes")


def add_allow_code(parser: argparse.ArgumentParser) -> None:
    """The permission to import the code that scenes name; the program acts on it."""
    parser.add_argument("--allow-code", action="store_true", help=_ALLOW_CODE)
