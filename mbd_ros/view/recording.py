"""A motion as one page that needs nothing but itself: geometry, motion and player inlined."""

import re
from html import escape
from typing import Any, NamedTuple

import numpy as np

from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.drawing import Drawing
from mbd_ros.view.motion import ViewedMotion
from mbd_ros.view.page import nearest_row
from mbd_ros.view.server import started, stop

RATE = 60.0  # images a second of a page
_MOST = 3600  # images: longer motions have fewer a second
POLICY = (  # the inlined player makes functions of strings; whatever it does, nothing is loaded
    "default-src 'none'; img-src data: blob:; style-src 'unsafe-inline'; font-src data:; "
    "script-src 'unsafe-inline' 'unsafe-eval' blob: data:; worker-src blob: data:; "
    "connect-src data: blob:"
)


class AnimatedPage(NamedTuple):
    """A page.

    Attributes:
        remarks: What cannot be drawn, a line each.
    """

    text: str
    remarks: tuple[str, ...]


def animated_page(
    scene: Scene,
    motion: ViewedMotion,
    title: str,
    ghost: ViewedMotion | None = None,
    slower: float = 1.0,
) -> AnimatedPage:
    """A page with play, slider and speed that opens from a file without a network.

    Args:
        motion: What it shows.
        title: Of the page.
        ghost: A second motion, drawn through.
        slower: Seconds of the page a second of the motion.

    Returns:
        The page, whose policy lets it load nothing.
    """
    server = started(title)
    try:
        drawing = Drawing(server, scene)
        drawing.show(motion)
        if ghost is not None:
            drawing.show_ghost(ghost)
        recorded = server.get_scene_serializer()
        _record(recorded, drawing, slower)
        text: str = recorded.as_html()
    finally:
        stop(server)
    head = (
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f"<title>{escape(title)}</title>"
    )
    text = re.sub(r"<title>.*?</title>", lambda _: head, text, count=1)
    return AnimatedPage(text, tuple(drawing.remarks))


def _record(recorded: Any, drawing: Drawing, slower: float) -> None:
    """Draw the motion at an even rate, each image for as long as it lasts."""
    times = drawing.motion.times
    end = float(times[-1])
    count = int(min(max(round(end * slower * RATE), 1), _MOST))
    for now in np.linspace(0.0, end, count + 1):
        drawing.draw(nearest_row(times, float(now)))
        if end > 0.0:
            recorded.insert_sleep(end * slower / count)
