"""Names that are unique, and that a scene takes."""

from __future__ import annotations

import re
from collections.abc import Iterable

_ODD = re.compile(r"[^\w/-]", re.ASCII)


class Names:
    """Names that are taken.

    Args:
        taken: Those that are taken before.
    """

    def __init__(self, taken: Iterable[str] = ()) -> None:
        self._taken = set(taken)

    def __contains__(self, name: str) -> bool:
        return name in self._taken

    def take(self, wish: str, ending: str = "") -> str:
        """A name like the wish that nothing else has; it is taken from now on.

        Args:
            ending: What it gets where the wish is taken, before it gets a number.
        """
        name, number = wish, 2
        if name in self._taken and ending:
            name = wish = f"{wish}_{ending}"
        while name in self._taken:
            name, number = f"{wish}_{number}", number + 1
        self._taken.add(name)
        return name

    def part(self, wish: str, ending: str) -> str:
        """As `take`, of the characters that names of parts of a scene have."""
        return self.take(plain(wish) or ending, ending)


def plain(name: str) -> str:
    """A name with `_` in place of the characters that a scene does not take."""
    return _ODD.sub("_", name)[:200]
