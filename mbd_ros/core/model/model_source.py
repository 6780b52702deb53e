"""What a robot or a body is read from, and what its links and joints are called."""

from collections.abc import Mapping
from typing import Any, NamedTuple


class Recipe(NamedTuple):
    """One robot or body of a scene, before it is read.

    Attributes:
        text: URDF.
        source: File or topic of the text, for the messages.
        base: `fixed`, or `floating` for a root link that moves freely.
        locked: Joint -> position [rad or m] of joints to freeze and remove.
        rename: URDF joint name -> the name that it goes by.
        inertias: Of links, in place of those of the text, see `Robot.with_inertias`.
        name: In the scene; empty for the only robot, whose links and joints keep their names.
        pose: `pinocchio.SE3` of the root link in the world, at the start if that moves freely;
            None where the description says.
        shape: Kind and sizes, as a scene writes them, of a body that has only one link; None
            where the description says.
        any_inertias: Whether moments of inertia that no body has are taken as they are.
    """

    text: str
    source: str
    base: str = "fixed"
    locked: Mapping[str, float] | None = None
    rename: Mapping[str, str] | None = None
    inertias: Mapping[str, Any] | None = None
    name: str = ""
    pose: Any = None
    shape: tuple[str, Any] | None = None
    any_inertias: bool = False

    def scoped(self, name: str) -> str:
        """What a joint, or a link that is not the root, is called in the scene."""
        return f"{self.name}/{name}" if self.name else name
