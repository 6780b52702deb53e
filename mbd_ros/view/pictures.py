"""A picture and a film of what a browser shows, as files that it downloads."""

import io
import time
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from mbd_ros.view.controls import Controls

_HEIGHT, _WIDTH = 600, 800
_IMAGES, _PERIOD = 60, 50  # of a film, and ms of each
_WAIT = 0.01  # s, until another look at what is drawn
_PATIENCE = 10.0  # s, for an image of a browser


def picture(client: Any) -> None:
    """Send a browser the picture that it shows, a .png."""
    image = client.get_render(_HEIGHT, _WIDTH, transport_format="png", timeout=_PATIENCE)
    client.send_file_download("view.png", written([image], "png"), save_immediately=True)


def film(client: Any, controls: "Controls") -> None:
    """Send a browser the motion as it shows it, a .gif."""
    controls.plays = False
    images = []
    for now in np.linspace(0.0, controls.end, _IMAGES):
        controls.now = float(now)
        end = time.monotonic() + _PATIENCE
        while controls.reached != controls.now and time.monotonic() < end:
            time.sleep(_WAIT)
        images.append(client.get_render(_HEIGHT, _WIDTH, timeout=_PATIENCE))
    client.send_file_download("view.gif", written(images, "gif"), save_immediately=True)


def written(images: list[Any], kind: str) -> bytes:
    """A file of images.

    Args:
        images: Each of shape (height, width, 3 or 4), uint8; one for a .png.
        kind: `png` or `gif`.
    """
    from PIL import Image

    first, *others = (Image.fromarray(np.asarray(image, dtype=np.uint8)) for image in images)
    file = io.BytesIO()
    if kind == "gif":
        first.save(file, "GIF", save_all=True, append_images=others, duration=_PERIOD, loop=0)
    else:
        first.save(file, kind.upper())
    return file.getvalue()
