"""Parameters of the node `payload_estimator`."""

from mbd_ros.nodes.shell.parameters import Parameter
from mbd_ros.nodes.shell.stream_parameters import TUNING, stream_parameters, tunable

PARAMETERS = (
    *stream_parameters(
        "scene",
        "allow_code",
        *TUNING,
        "timeout",
        "clock_tolerance",
    ),
    Parameter("frame", str, "Link that carries the payload; empty: the last one.", ""),
    tunable("memory", 10.0, 0.1, 1e4, "Time after which samples count 1/e [s]."),
    tunable("largest_mass", 10.0, 1e-6, 1e6, "Mass that may be expected [kg]."),
    tunable("size", 0.2, 1e-4, 100.0, "Size of the payload that may be expected [m]."),
)
