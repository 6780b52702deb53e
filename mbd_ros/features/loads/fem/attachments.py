"""Which nodes of a mesh take which load."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from mbd_ros.core.state import Array
from mbd_ros.errors import DataError
from mbd_ros.features.loads.fem.mesh import Mesh, Nodes
from mbd_ros.features.loads.history import History

COUPLINGS = "rigid", "distributing"
_NOTHING = 1.0e-9  # of the largest load: less is rounding and needs no nodes


class Attachment(NamedTuple):
    """Nodes that take a load together.

    Attributes:
        name: Of the load.
        slot: Its place in the history.
        reference: Where the load is written about [m], shape (3,).
        nodes: They.
    """

    name: str
    slot: int
    reference: Array
    nodes: Nodes


def attachments_of(
    history: History, mesh: Mesh, given: Mapping[str, str], radius: float | None
) -> list[Attachment]:
    """Nodes of every load.

    Args:
        history: The loads.
        mesh: The mesh.
        given: Load -> name of a set of nodes, or a radius about its point [m].
        radius: Of loads that are not given [m]; None where all are.

    Raises:
        DataError: A load that is unknown, has no nodes, or shares some with another; an unknown
            set; nodes that are nowhere near their load.
    """
    names = [slot.name for slot in history.slots]
    for name in given:
        if name not in names:
            raise DataError(f"--attach {name}: no such load; accepted: {', '.join(names)}")
    largest = max(float(np.abs(each).max(initial=0.0)) for each in (history.force, history.moment))
    least, found = _NOTHING * largest, []
    for slot, name in enumerate(names):
        values = history.force[:, slot], history.moment[:, slot]
        if max(float(np.abs(each).max(initial=0.0)) for each in values) <= least:
            continue
        reference = history.point[:, slot].mean(axis=0)
        nodes = _nodes(mesh, name, reference, given, radius)
        found.append(Attachment(name, slot, reference, nodes))
    _check_apart(found)
    return found


def _nodes(
    mesh: Mesh, name: str, reference: Array, given: Mapping[str, str], radius: float | None
) -> Nodes:
    word = given.get(name, radius)
    if word is None:
        known = ", ".join(mesh.sets) or "none"
        raise DataError(
            f"load {name} has no nodes: --attach {name}=SET, {name}=RADIUS, or --radius for all; "
            f"sets of {mesh.name}: {known}"
        )
    if isinstance(word, str) and word in mesh.sets:
        nodes = np.unique(mesh.sets[word])
        centre = mesh.points[nodes].mean(axis=0) if len(nodes) else reference
        off = float(np.linalg.norm(centre - reference))
        if not len(nodes) or off > 2.0 * mesh.diagonal:
            raise DataError(
                f"{mesh.name}: the {len(nodes)} nodes of set {word} are {off:.4g} m from load "
                f"{name}; check --units and --mesh-pose"
            )
        return nodes
    try:
        about = float(word)
    except ValueError:
        known = ", ".join(mesh.sets) or "none"
        raise DataError(
            f"--attach {name}={word}: no such set; sets of {mesh.name}: {known}"
        ) from None
    if not (np.isfinite(about) and about > 0.0):
        raise DataError(f"--attach {name}: a radius of {about:g} m; accepted: > 0")
    far = np.linalg.norm(mesh.points - reference, axis=1)
    nodes = np.flatnonzero(far <= about)
    if len(nodes) < 3:
        raise DataError(
            f"{mesh.name}: {len(nodes)} nodes within {about:.4g} m of load {name}, accepted: 3 or "
            f"more; the nearest is {far.min():.4g} m away; check --units and --mesh-pose"
        )
    return nodes


def _check_apart(found: Sequence[Attachment]) -> None:
    """Refuse nodes that two loads would hold."""
    for i, one in enumerate(found):
        for other in found[i + 1 :]:
            if shared := np.intersect1d(one.nodes, other.nodes).size:
                raise DataError(
                    f"loads {one.name} and {other.name} share {shared} nodes; give them sets or "
                    "radii that do not"
                )


def check_tied(mesh: Mesh, attachments: Sequence[Attachment], support: str) -> None:
    """Refuse solids that nothing ties to the nodes of the support: they would fly away.

    Raises:
        DataError: Names a node of one.
    """
    groups = [cells for _, cells in mesh.blocks] + [one.nodes[None] for one in attachments]
    pairs = [(np.repeat(c[:, 0], c.shape[1] - 1), c[:, 1:].ravel()) for c in groups]
    i, j = (np.concatenate(ends) for ends in zip(*pairs, strict=True))
    n = len(mesh.points)
    _, part = connected_components(coo_array((np.ones(len(i)), (i, j)), (n, n)), directed=False)
    held = next(one.nodes[0] for one in attachments if one.name == support)
    loose = np.flatnonzero(part != part[held])
    if len(loose):
        place = ", ".join(f"{value:.4g}" for value in mesh.points[loose[0]])
        raise DataError(
            f"{mesh.name}: {len(loose)} nodes, as that at {place} m of the body, share no element "
            f"with what {support} holds; solids that touch must share nodes"
        )
