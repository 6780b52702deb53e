"""Everything that mbd_ros raises on purpose."""


class MbdError(Exception):
    """Root of the errors of this package."""


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
