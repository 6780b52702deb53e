"""Names of earlier versions, so that an error tells the new one."""

from collections.abc import Mapping

RENAMED: Mapping[str, Mapping[str, str]] = {  # kind -> old name -> new name
    "column": {},  # the quantity, after the last dot
    "command": {},
    "module": {  # with all modules below it
        "mbd_ros.core.body_loads": "mbd_ros.core.dynamics.body_loads",
        "mbd_ros.core.couplings": "mbd_ros.core.model.couplings",
        "mbd_ros.core.description": "mbd_ros.core.model",
        "mbd_ros.core.differentiation": "mbd_ros.core.estimation.differentiation",
        "mbd_ros.core.discontinuous": "mbd_ros.core.events",
        "mbd_ros.core.forward.bounded_rows": "mbd_ros.core.optimization.bounded_rows",
        "mbd_ros.core.forward.constraint_rows": "mbd_ros.core.rows.constraint_rows",
        "mbd_ros.core.forward.row_factor": "mbd_ros.core.rows.row_factor",
        "mbd_ros.core.forward.row_order": "mbd_ros.core.rows.row_layout",
        "mbd_ros.core.forward": "mbd_ros.core.dynamics",
        "mbd_ros.core.inverse_dynamics": "mbd_ros.core.inverse.inverse_dynamics",
        "mbd_ros.core.laws": "mbd_ros.core.model.coupling_functions",
        "mbd_ros.core.live": "mbd_ros.core.simulation",
        "mbd_ros.core.loops": "mbd_ros.core.inverse",
        "mbd_ros.core.manifold": "mbd_ros.core.projection",
        "mbd_ros.core.robot": "mbd_ros.core.model.robot",
        "mbd_ros.core.rows.row_order": "mbd_ros.core.rows.row_layout",
        "mbd_ros.core.stabilizing": "mbd_ros.core.projection.stabilizing",
        "mbd_ros.core.stepping": "mbd_ros.core.integration.stepping",
        "mbd_ros.core.system": "mbd_ros.core.dynamics.system",
        "mbd_ros.core.tiers": "mbd_ros.core.dynamics.tiers",
        "mbd_ros.core.wrenches": "mbd_ros.core.model.wrenches",
        "mbd_ros.bags": "mbd_ros.files.bags",
        "mbd_ros.recordings": "mbd_ros.files.recordings",
        "mbd_ros.tables": "mbd_ros.files.csv",
    },
    "option": {},
    "parameter": {},
    "topic": {},
}


def renamed(kind: str, name: str) -> str:
    """Hint for a message about a name that does not exist.

    Args:
        kind: A key of `RENAMED`.
        name: As it was given.

    Returns:
        `; <name> is called <new name> now`, or nothing where it never had another name.
    """
    for old, new in RENAMED[kind].items():
        if kind == "column" and name.endswith(f".{old}"):
            now = name.removesuffix(old) + new
        elif kind == "module" and name.startswith(f"{old}."):
            now = new + name.removeprefix(old)
        elif name == old:
            now = new
        else:
            continue
        return f"; {name} is called {now} now"
    return ""
