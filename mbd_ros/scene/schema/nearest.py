"""Names that somebody may have meant."""

from collections.abc import Iterable
from difflib import get_close_matches


def nearest(word: str, names: Iterable[str], count: int = 3) -> list[str]:
    """The names that are spelled most like a word, best first.

    Args:
        word: What was given.
        names: Existing names; of `folder/name` the end counts too.
        count: At most so many.
    """
    ends: dict[str, str] = {}
    for name in names:
        ends.setdefault(name, name)
        ends.setdefault(name.rpartition("/")[2], name)
    close = get_close_matches(word, ends, 2 * count)
    return list(dict.fromkeys(ends[end] for end in close))[:count]
