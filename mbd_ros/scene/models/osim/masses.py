"""Masses and moments of inertia of the bodies of a model."""

from mbd_ros.scene.models.osim.frames import six_digits
from mbd_ros.scene.models.osim.item import Item
from mbd_ros.scene.models.urdf_text import Mass

_MOMENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
_NONE = (0.0,) * 6


def mass_of(body: Item) -> Mass:
    """Mass of a `<Body>` of any format.

    Raises:
        SceneError: Names body and element.
    """
    if body.find("inertia") is not None:
        moments = body.vector("inertia", default=_NONE, length=6)
    else:
        tags = [f"inertia_{key}" for key in _MOMENTS]  # before 4.0
        moments = [six_digits(body.number(tag, default=0.0)) for tag in tags]
    return Mass(body.number("mass", default=0.0), body.vector("mass_center"), moments)
