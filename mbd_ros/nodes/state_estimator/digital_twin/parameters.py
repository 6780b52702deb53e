"""Parameters of the node `digital_twin`."""

from mbd_ros.nodes.shell.parameters import Parameter
from mbd_ros.nodes.shell.stream_parameters import tunable
from mbd_ros.nodes.state_estimator.parameters import ESTIMATION

PARAMETERS = (
    *ESTIMATION,
    Parameter(
        "reactions",
        list[str],
        "Joints whose reactions are published on `~/reactions/<joint>`; `all` for every one.",
        (),
    ),
    tunable("horizon", 1.0, 1e-3, 60.0, "Time that `~/predict` predicts [s]."),
    tunable("prediction_step", 0.01, 1e-3, 1.0, "Between two points of a prediction [s]."),
    Parameter(
        "look_ahead",
        float,
        "Singular configurations that are no farther away are flagged [s].",
        0.05,
        low=1e-3,
        high=1.0,
    ),
    Parameter(
        "amplification",
        float,
        "Amplification of errors of what is measured from which a configuration is singular.",
        100.0,
        low=1.0,
        high=1e9,
    ),
    Parameter(
        "alarm_threshold",
        float,
        "Cumulative sum of residuals, in deviations, that is an alarm.",
        30.0,
        low=1.0,
        high=1e6,
    ),
    Parameter(
        "hypotheses",
        list[str],
        "Faults that may be named: `<name>: <part>.<argument>=<number>, ..`, one a text.",
        (),
    ),
    Parameter(
        "naming_window",
        float,
        "Time over which faults are compared [s].",
        1.0,
        low=0.01,
        high=600.0,
    ),
)
