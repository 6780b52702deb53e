"""Everything that mbd_ros raises on purpose, and the exit codes of its programs."""

OK, FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
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
    """Root of the errors of this package; its message is `printable`.

    Attributes:
        exit_code: That of a program which this error ends.
    """

    exit_code = BAD_INPUT

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


class NotConvergedError(SolveError):
    """A motion that was looked for and not found: says what stands against it.

    Attributes:
        result: The last iterate, a `Result` that is marked as not converged; None without one.
    """

    exit_code = FAILED

    def __init__(self, message: str = "", result: object = None) -> None:
        super().__init__(message)
        self.result = result


class JammedError(SolveError):
    """Friction leaves contacts that slip no consistent acceleration (Painlevé): names them."""


class FallError(MbdError):
    """A motion that does not come to the end of a cycle: says when it ended, and why."""


class DivergedError(MbdError):
    """A simulation that stopped being finite: names joint, time and last finite state."""


_ROS = "ros-jazzy-rclpy ros-jazzy-common-interfaces ros-jazzy-rmw-fastrtps-cpp"
_MESSAGES = "diagnostic geometry lifecycle rosgraph sensor std trajectory visualization"
PACKAGES = {  # module -> what pip calls the package that brings it
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
    """Hint for a module that is not installed; empty where this package needs no such module.

    Args:
        module: As it is imported, perhaps with dots.
    """
    name = module.partition(".")[0]
    if name not in PACKAGES:
        return ""
    sourced = ", or source a ROS 2 Jazzy installation" if PACKAGES[name] == _ROS else ""
    return f"{name} is not installed: pip install {PACKAGES[name]}{sourced}"
