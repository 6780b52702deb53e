"""Networks of a kind: their first weights, and what their members say together."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError, install_hint
from mbd_ros.features.identification.learn.scales import Samples, Scales

Tell = Callable[[float], None]


def require_torch() -> None:
    """Refuse to learn without torch.

    Raises:
        DataError: With the line that installs it.
    """
    from importlib.util import find_spec

    for module in ("torch", "onnx"):
        if find_spec(module) is None:
            raise DataError(f"learning: {install_hint(module)}")


def network_of(kind: str, scales: Scales, accelerations: bool = False) -> Any:
    """The network of a kind."""
    from mbd_ros.features.identification.learn.network import Free, Structured

    return Structured(scales) if kind == "structured" else Free(scales, accelerations)


def first_weights(
    kind: str, m: int, members: int, random: np.random.Generator, accelerations: bool = False
) -> Mapping[str, Array]:
    """First weights of a network."""
    from mbd_ros.features.identification.learn.network import free_weights, structured_weights

    if kind == "structured":
        return structured_weights(m, members, random)
    return free_weights(m, members, (4 if accelerations else 3) * m, random)


def said_by(network: Any, weights: Mapping[str, Array], samples: Samples) -> Array:
    """Mean torque of the members [N·m or N], shape (n, m)."""
    import torch

    with torch.no_grad():
        w = {key: torch.as_tensor(value) for key, value in weights.items()}
        found: Array = network.torque(w, *network.inputs(samples)).mean(dim=0).numpy()
    return found * network.scales.torque
