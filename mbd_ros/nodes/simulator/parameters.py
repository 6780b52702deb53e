"""Parameters of the node `simulator`."""

from mbd_ros.nodes.shell.parameters import ALLOW_CODE, Parameter

PARAMETERS = (
    Parameter("scene", str, "Scene: a file, or the name of an embedded one."),
    ALLOW_CODE,
    Parameter(
        "rate",
        float,
        "Ticks per simulated second [Hz]; a tick is a whole number of steps of the scene's dt.",
        1000.0,
        low=1e-2,
        high=1e5,
    ),
    Parameter(
        "real_time_factor",
        float,
        "Simulated seconds per second; 0 is as fast as possible.",
        1.0,
        low=0.0,
        high=1e3,
        read_only=False,
    ),
    Parameter("publish_clock", bool, "Publish /clock, and stamp with simulated time.", False),
    Parameter("paused", bool, "Start paused.", False),
    Parameter(
        "lock_step", bool, "Time stands, and each good command advances it by one tick.", False
    ),
    Parameter(
        "joints",
        list[str],
        "Order of the values in ~/commands, by joint or input; empty: that of the actuators.",
        (),
    ),
    Parameter(
        "command_timeout",
        float,
        "Simulated time without a command until the safe one takes over [s].",
        0.1,
        low=1e-4,
        high=1e6,
        read_only=False,
    ),
    Parameter(
        "safe_ramp",
        float,
        "Simulated time in which the safe command takes over, and gives way again [s].",
        0.1,
        low=0.0,
        high=1e3,
        read_only=False,
    ),
    Parameter(
        "marker_rate",
        float,
        "Markers of constraint forces per second [Hz]; 0 is none.",
        30.0,
        low=0.0,
        high=1e3,
        read_only=False,
    ),
    Parameter(
        "marker_scale",
        float,
        "Length of an arrow per force [m/N].",
        0.002,
        low=0.0,
        high=1e3,
        read_only=False,
    ),
    Parameter(
        "compiled",
        bool,
        "Ticks run in native code, as with solver compiled; false is as the scene says.",
        False,
    ),
    Parameter(
        "pushed_links",
        list[str],
        "Links that a WrenchStamped on ~/push may load, the link as its frame; * is all that "
        "move.",
        (),
    ),
    Parameter(
        "seed",
        int,
        "Of the noise of the sensors of the scene: the same seed, the same noise.",
        0,
        low=0,
        high=2**31 - 1,
    ),
)
