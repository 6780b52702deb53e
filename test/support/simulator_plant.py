"""The plant of the node `simulator`, without the node."""

from types import SimpleNamespace

from mbd_ros.nodes.simulator.parameters import PARAMETERS
from mbd_ros.nodes.simulator.plant import Plant


def plant(scene, **given):
    """As the node makes it from its parameters: those given, and the defaults of the others."""
    given["scene"] = str(scene)
    values = {spec.key: spec.read(given.pop(spec.key, spec.default)) for spec in PARAMETERS}
    assert not given, f"no parameters of the simulator: {sorted(given)}"
    return Plant(SimpleNamespace(**values), None)
