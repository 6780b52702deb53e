"""Parameters of the node `web_view`."""

from mbd_ros.nodes.shell.parameters import Parameter
from mbd_ros.nodes.shell.stream_parameters import ALLOW_CODE

FASTEST = 30.0  # Hz, to browsers

PARAMETERS = (
    Parameter("scene", str, "Scene: a file, or the name of an embedded one."),
    ALLOW_CODE,
    Parameter(
        "namespaces",
        list[str],
        "Namespaces of the robots, one each; empty for one robot in that of the node.",
        (),
    ),
    Parameter(
        "scenes", list[str], "Scene of each robot, if they differ; empty: all have `scene`.", ()
    ),
    Parameter(
        "offsets",
        list[float],
        "x, y and z of the world of each robot on the page [m]; empty: robots of one scene stand "
        "side by side, others where their scenes place them.",
        (),
        low=-1e6,
        high=1e6,
    ),
    Parameter(
        "host",
        str,
        "Address to listen on; another one than this machine's asks for a token.",
        "127.0.0.1",
    ),
    Parameter(
        "port",
        int,
        "Port to listen on; the next one that is free where it is taken.",
        8080,
        low=1,
        high=65535,
    ),
    Parameter(
        "token",
        str,
        "What a browser must know; empty: nothing on this machine's address, and on another one "
        "what the node makes up and logs.",
        "",
    ),
    Parameter(
        "origins",
        list[str],
        "Addresses under which a proxy shows the page, such as https://robots.example.",
        (),
    ),
    Parameter(
        "rate",
        float,
        "Frames that browsers get a second at most [Hz].",
        FASTEST,
        low=0.1,
        high=FASTEST,
    ),
    Parameter("window", float, "Time that curves show [s].", 10.0, low=0.1, high=600.0),
    Parameter(
        "simulator", str, "Node whose buttons the page has, in each namespace.", "simulator"
    ),
    Parameter(
        "controller",
        str,
        "Node that is led by targets, in each namespace; empty: whichever hears a reference.",
        "",
    ),
    Parameter(
        "constraint_forces",
        str,
        "Topic of multipliers, in each namespace.",
        "simulator/constraint_forces",
    ),
    Parameter(
        "torques",
        str,
        "Topic of computed torques, in each namespace.",
        "inverse_dynamics/joint_torques",
    ),
    Parameter("markers", str, "Topic of markers, in each namespace.", "markers"),
)
