"""A picture and a film of what a browser shows, as files that it downloads."""

import io
import time
from collections.abc import Iterable
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from mbd_ros.errors import install_hint

if TYPE_CHECKING:
    from mbd_ros.view.controls import Controls

_HEIGHT, _WIDTH = 720, 1280
_RATE = 30  # images a second of a film
_FEWEST, _MOST = 30, 300  # images of a film: a longer motion is shown faster
_WAIT = 0.01  # s, until another look at what is drawn
_PATIENCE = 20.0  # s, for an image of a browser


def picture(client: Any, controls: "Controls") -> None:
    """Send a browser the picture that it shows, a .png."""
    _send(client, controls, "view.png", lambda: png(_image(client, "png")))


def film(client: Any, controls: "Controls") -> None:
    """Send a browser the motion at the speed at which it plays, an .mp4."""
    controls.plays = False
    count = round(controls.end / controls.speed * _RATE)
    times = np.linspace(0.0, controls.end, min(max(count, _FEWEST), _MOST)).tolist()
    _send(client, controls, "view.mp4", lambda: mp4(_images(client, controls, times)))


def _send(client: Any, controls: "Controls", name: str, make: Any) -> None:
    """Make a file and send it, or say why not."""
    try:
        client.send_file_download(name, make(), save_immediately=True)
    except TimeoutError:
        controls.say([f"{name}: the browser sends no images"])
    except ImportError as error:
        controls.say([f"{name}: {install_hint(error.name or '') or error}"])


def _image(client: Any, transport: str) -> Any:
    return client.get_render(_HEIGHT, _WIDTH, transport_format=transport, timeout=_PATIENCE)


def _images(client: Any, controls: "Controls", times: Iterable[float]) -> Iterable[Any]:
    for now in times:
        controls.now = now
        end = time.monotonic() + _PATIENCE
        while controls.reached != controls.now and time.monotonic() < end:
            time.sleep(_WAIT)
        yield _image(client, "jpeg")


def png(image: Any) -> bytes:
    """A picture as a file.

    Args:
        image: Shape (height, width, 3 or 4), uint8.
    """
    from PIL import Image

    file = io.BytesIO()
    Image.fromarray(np.asarray(image, dtype=np.uint8)).save(file, "PNG")
    return file.getvalue()


def mp4(images: Iterable[Any]) -> bytes:
    """A film as a file, H.264 at 30 images a second.

    Args:
        images: At least one, all of one shape (height, width, 3 or 4), uint8, both sizes even.
    """
    import av  # of the extra `view`

    file, stream = io.BytesIO(), None
    with av.open(file, "w", format="mp4") as container:
        for image in images:
            pixels = np.ascontiguousarray(image[..., :3], dtype=np.uint8)
            if stream is None:
                stream = container.add_stream("libx264", rate=Fraction(_RATE))
                stream.height, stream.width = pixels.shape[:2]
                stream.pix_fmt = "yuv420p"
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode())
    return file.getvalue()
