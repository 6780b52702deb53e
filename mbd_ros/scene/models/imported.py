"""What a model of another program becomes, and what of it a scene does not have."""

from typing import Any, NamedTuple

from mbd_ros.errors import SceneError


class LeftOut(NamedTuple):
    """An element that the scene does not have.

    Attributes:
        type: Its class in the other program.
        name: Its name.
        reason: Why it is left out.
    """

    type: str
    name: str
    reason: str

    def __str__(self) -> str:
        return f"{self.type} '{self.name}': {self.reason}"


class Unexpressed(SceneError):
    """An element that a scene cannot express; its message says why, for the list of left-outs."""


class Imported(NamedTuple):
    """What a model becomes.

    Attributes:
        name: Of the model.
        urdf: Its bodies and joints.
        robot: Keys of the section `robot` besides the description.
        sections: The other sections.
        left_out: Elements that they do not have.
    """

    name: str
    urdf: str
    robot: dict[str, Any]
    sections: dict[str, Any]
    left_out: tuple[LeftOut, ...]
