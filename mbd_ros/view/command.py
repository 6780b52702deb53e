"""The command `mbd-ros view`: a scene and its motion in a browser."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from mbd_ros.errors import OK, DataError
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.progress import say, say_all
from mbd_ros.motion.options import add_topic
from mbd_ros.scene.schema.locate import path_word

if TYPE_CHECKING:
    from mbd_ros.scene.built_scene import Scene

_DURATION = 2.0  # s


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `view`."""
    add_scene(parser)
    parser.add_argument(
        "motion",
        nargs="?",
        type=path_word,
        help="Result, table or bag. By default the scene is simulated.",
    )
    parser.add_argument("--ghost", type=path_word, help="Second motion, drawn transparently.")
    text = "Write one .html, which opens from a file without a network, and serve no page."
    parser.add_argument("-o", "--out", type=path_word, metavar="FILE", help=text)
    parser.add_argument(
        "-t",
        "--time",
        type=float,
        default=_DURATION,
        help=f"Simulated time [s] (default: {_DURATION:g}).",
    )
    parser.add_argument(
        "--parameter",
        action="append",
        default=[],
        metavar="PART.ARGUMENT",
        help="Number of the scene that can be changed on the page; repeat the option for more.",
    )
    add_topic(parser)
    parser.add_argument(
        "--host", default="127.0.0.1", help="Address of the server (default: %(default)s)."
    )
    parser.add_argument(
        "--port", type=int, default=8080, help="Port of the server (default: %(default)s)."
    )
    parser.add_argument("--no-browser", action="store_true", help="Do not open a browser.")


def run(arguments: argparse.Namespace) -> int:
    """Show the page until Ctrl-C, or write it, and return the exit code."""
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
