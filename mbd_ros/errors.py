"""The errors that mbd_ros raises, the exit codes of its programs, and installation hints."""

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
_MAX_WORD, _MAX_LINE = 400, 2000  # characters; longer words and lines are shortened


def printable(text: str) -> str:
    """Return the text with control characters escaped and very long words and lines shortened.

    Args:
        text: Any text; line breaks are kept.
    """
    if text.isprintable() and len(text) <= _MAX_WORD:
        return text
    escaped = "".join(c if c.isprintable() or c == "\n" else ascii(c)[1:-1] for c in text)
    return "\n".join(_shorten(_shorten_words(line), _MAX_LINE) for line in escaped.split("\n"))


def _shorten_words(line: str) -> str:
    return " ".join(_shorten(word, _MAX_WORD) for word in line.split(" "))


def _shorten(text: str, longest: int) -> str:
    """Replace the middle of a long text, so that at most `longest` characters remain."""
    if len(text) <= longest:
        return text
    middle = f".. {len(text)} characters .."
    end = longest // 4
    return text[: longest - end - len(middle)] + middle + text[-end:]


class MbdError(Exception):
    """Base class of the errors of this package; its message contains no control characters.

    Attributes:
        exit_code: Exit code of a program that stops with this error.
    """

    exit_code = BAD_INPUT

    def __init__(self, message: str = "") -> None:
        super().__init__(printable(message))


class SceneError(MbdError):
    """A scene cannot be built; the message names file, key and accepted values."""


class ModelError(MbdError):
    """A model is not valid; the message names the link, joint or argument and the condition."""


class DataError(MbdError):
    """A table, bag or result cannot be used; the message names file, column or topic."""


class SolveError(MbdError):
    """Equations have no accurate solution; the message names the constraints and residuals."""


class NotConvergedError(SolveError):
    """An optimization or search did not converge; the message names what it violates most.

    Attributes:
        result: The last iterate as a `Result` marked as not converged, or None.
    """

    exit_code = FAILED

    def __init__(self, message: str = "", result: object = None) -> None:
        super().__init__(message)
        self.result = result


class JammedError(SolveError):
    """Slipping contacts admit no consistent acceleration (Painlevé's paradox); it names them."""


class FallError(MbdError):
    """A walking motion ended before its cycle was complete; the message says when and why."""


class DivergedError(MbdError):
    """A simulation diverged; the message names the joint, the time and the last finite state."""


_ROS = "ros-jazzy-rclpy ros-jazzy-common-interfaces ros-jazzy-rmw-fastrtps-cpp"
_MESSAGES = "diagnostic geometry lifecycle rosgraph sensor std trajectory visualization"
PACKAGES = {  # module -> argument of `pip install` for the package that contains it
    **{
        name: name
        for name in ("apsw", "exudyn", "matplotlib", "mujoco", "numpy", "pandas", "pyarrow")
    },
    **{name: name for name in ("proxsuite", "qpsolvers", "rosbags", "scipy")},
    **dict.fromkeys(("rclpy", "rcl_interfaces", "std_srvs"), _ROS),
    **{f"{name}_msgs": _ROS for name in _MESSAGES.split()},
    "av": "'mbd_ros[view]'",
    "casadi": "'mbd_ros[compiled]'",
    "clarabel": "'mbd_ros[identification]'",
    "ezc3d": "'mbd_ros[biomechanics]'",
    "distributed": "'dask[distributed]'",
    "eigenpy": "pin",
    "meshio": "'mbd_ros[fem]'",
    "pinocchio": "pin",
    "pydrake": "drake",
    "onnx": "'mbd_ros[learn]'",
    "onnxruntime": "'mbd_ros[learned]'",
    "torch": "'mbd_ros[learn]'",
    "viser": "'mbd_ros[view]'",
    "yaml": "PyYAML",
}


def install_hint(module: str) -> str:
    """Return how to install a missing module, or "" if this package does not use that module.

    Args:
        module: Dotted name of the module, as it is imported.
    """
    name = module.partition(".")[0]
    if name not in PACKAGES:
        return ""
    sourced = ", or source a ROS 2 Jazzy installation" if PACKAGES[name] == _ROS else ""
    return f"{name} is not installed: pip install {PACKAGES[name]}{sourced}"
