"""Everything that mbd_ros raises on purpose."""

_WORD, _LINE = 400, 2000  # characters that are shown whole


def printable(text: str) -> str:
    """Text that a terminal shows as it stands: no control characters, long words and lines cut.

    Args:
        text: Any text; its line breaks stay.
    """
    if text.isprintable() and len(text) <= _WORD:
        return text
    escaped = "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)
    return "\n".join(_cut(_words(line), _LINE) for line in escaped.split("\n"))


def _words(line: str) -> str:
    return " ".join(_cut(word, _WORD) for word in line.split(" "))


def _cut(text: str, longest: int) -> str:
    """The text without its middle, at most `longest` characters."""
    if len(text) <= longest:
        return text
    said = f".. {len(text)} characters .."
    end = longest // 4
    return text[: longest - end - len(said)] + said + text[-end:]


class MbdError(Exception):
    """Root of the errors of this package; its message is `printable`."""

    def __init__(self, message: str = "") -> None:
        super().__init__(printable(message))


class SceneError(MbdError):
    """A scene file that cannot be built: names file, key and what is accepted."""


class ModelError(MbdError):
    """A robot description that cannot be trusted: names link or joint and the condition."""


class DataError(MbdError):
    """A motion, wrench table or bag that cannot be used: names file, column or topic."""


class SolveError(MbdError):
    """Equations without a trustworthy solution: names the rows and the residuals."""


class DivergedError(MbdError):
    """A simulation that stopped being finite: names joint, time and last finite state."""
