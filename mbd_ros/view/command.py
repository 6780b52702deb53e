"""Words of `mbd-ros view`."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say, say_all
from mbd_ros.scene.schema.locate import path_word

if TYPE_CHECKING:
    from mbd_ros.scene.built_scene import Scene


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `view` understands."""
    add_scene(parser)
    parser.add_argument(
        "motion", nargs="?", type=path_word, help="result, table or bag; else the scene is run"
    )
    parser.add_argument("--ghost", type=path_word, help="a second motion, drawn through")
    text = "writes one .html that opens from a file without a network, and serves nothing"
    parser.add_argument("-o", "--out", type=path_word, metavar="FILE", help=text)
    parser.add_argument("-t", "--time", type=float, default=2.0, help="simulated s (default: 2)")
    parser.add_argument(
        "--parameter",
        action="append",
        default=[],
        metavar="PART.ARGUMENT",
        help="a number of the scene to change on the page; repeat it for more",
    )
    parser.add_argument(
        "--topic",
        default="/joint_states",
        help="JointState topic of the bag (default: %(default)s)",
    )
    parser.add_argument("--host", default="127.0.0.1", help="address (default: %(default)s)")
    parser.add_argument("--port", type=int, default=8080, help="port (default: %(default)s)")
    parser.add_argument("--no-browser", action="store_true", help="open no browser")


def run(arguments: argparse.Namespace) -> int:
    """Do what the words say, until Ctrl-C; the exit code."""
    from mbd_ros.scene.reader import load_scene
    from mbd_ros.view.page import Page

    scene = load_scene(arguments.scene)
    if arguments.out is not None:
        return _write(arguments, scene)
    page = Page(scene, host=arguments.host, port=arguments.port, named=arguments.parameter)
    try:
        if arguments.motion is None:
            page.simulate(arguments.time)
        else:
            page.show(arguments.motion, topic=arguments.topic)
        if arguments.ghost is not None:
            page.show_ghost(arguments.ghost, topic=arguments.topic)
        say_all(page.notes)
        say(f"{page.address}  (Ctrl-C ends it)")
        if not arguments.no_browser:
            import webbrowser

            webbrowser.open(page.address)
        page.play()
    except KeyboardInterrupt:
        return OK
    finally:
        page.close()
    return OK


def _write(arguments: argparse.Namespace, scene: "Scene") -> int:
    """Write the motion as one file."""
    from mbd_ros.files.text_file import replacing
    from mbd_ros.view.controls import Rerun
    from mbd_ros.view.frames import Frames
    from mbd_ros.view.motion import viewed_motion
    from mbd_ros.view.recording import animated_page

    out, topic = arguments.out, arguments.topic
    if out.suffix != ".html":
        raise DataError(f"{out}: the page is a .html file")
    if arguments.parameter:
        raise DataError("--parameter: sliders are of the page that is served, not of that of -o")
    rows, motion, notes = Frames(scene).rows, arguments.motion, list[str]()
    if motion is None:
        rerun = Rerun(scene)
        rerun.duration = arguments.time
        _, motion, notes = rerun.run({})
    viewed = viewed_motion(scene, motion, rows, topic)
    ghost = arguments.ghost and viewed_motion(scene, arguments.ghost, rows, topic)
    page = animated_page(scene, viewed, Path(scene.name).name, ghost)
    with replacing(out) as file:
        file.write(page.text.encode())
    say_all([*page.remarks, *viewed.remarks, *notes, f"{out}: {len(page.text) / 1e6:.1f} MB"])
    return OK
