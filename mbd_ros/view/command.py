"""Words of `mbd-ros view`."""

import argparse

from mbd_ros.errors import OK
from mbd_ros.jobs.arguments import add_scene
from mbd_ros.jobs.lines import say
from mbd_ros.scene.locate import path_word


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The words that `view` understands."""
    add_scene(parser)
    parser.add_argument(
        "motion", nargs="?", type=path_word, help="result, table or bag; else the scene is run"
    )
    parser.add_argument("--ghost", type=path_word, help="a second motion, drawn through")
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
    page = Page(scene, host=arguments.host, port=arguments.port, named=arguments.parameter)
    try:
        if arguments.motion is None:
            page.simulate(arguments.time)
        else:
            page.show(arguments.motion, topic=arguments.topic)
        if arguments.ghost is not None:
            page.show_ghost(arguments.ghost, topic=arguments.topic)
        for line in page.said:
            say(line)
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
