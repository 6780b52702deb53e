"""The animated part of the page of a demo."""

from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mbd_ros.errors import install_hint
from mbd_ros.motion.recordings import Source
from mbd_ros.scene.built_scene import Scene
from mbd_ros.view.frames import Frames
from mbd_ros.view.motion import ViewedMotion, viewed_motion

if TYPE_CHECKING:
    from mbd_ros.applications.demo.numbers import DemoNumbers


def moving_run(numbers: "DemoNumbers", bag: Path, title: str) -> str:
    """The recorded motion of the plant with the forces that it published, as HTML to inline."""
    scene = numbers.plant
    rows = Frames(scene).rows
    motion = viewed_motion(scene, bag, rows)
    if rows and (forces := numbers.signals.forces) is not None:
        published = dict(zip((row.name for row in numbers.rows), rows, strict=True))
        columns = forces.columns(list(published))
        at = np.searchsorted(forces.time, motion.times + numbers.signals.states.time[0])
        multipliers = forces.effort[np.minimum(at, len(forces.time) - 1)][:, columns]
        motion = motion._replace(multipliers=multipliers)
    return inlined(scene, motion, title)


def moving_result(scene: Scene, result: Source, title: str, slower: float) -> str:
    """A simulated motion, `slower` times slower, as HTML to inline."""
    return inlined(scene, viewed_motion(scene, result, Frames(scene).rows), title, slower)


def inlined(scene: Scene, motion: ViewedMotion, title: str, slower: float = 1.0) -> str:
    """A frame around an animated page, or a line on what is not installed."""
    if find_spec("viser") is None:
        return f"<p>Nothing moves here: {escape(install_hint('viser'))}</p>"
    from mbd_ros.view.recording import animated_page

    text = escape(animated_page(scene, motion, title, slower=slower).text, quote=True)
    name = escape(title, quote=True)
    return f'<iframe title="{name}" sandbox="allow-scripts" srcdoc="{text}"></iframe>'
