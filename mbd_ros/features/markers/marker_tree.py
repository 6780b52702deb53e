"""Which coordinates carry markers, and which follow one another."""

import numpy as np
import pinocchio as pin

from mbd_ros.core.model.couplings import Couplings
from mbd_ros.core.state import Array


def orders(model: pin.Model, carriers: list[int]) -> tuple[Array, Array]:
    """What coordinates have to do with one another, and with markers.

    Returns:
        1 where j stands before k on a chain, 1/2 where both belong to one joint, else 0, shape
        (nv, nv); 1 where a coordinate moves a marker, shape (nv, n).
    """
    joint_of = np.zeros(model.nv, dtype=np.intp)
    for j, joint in enumerate(model.joints):
        if j:
            joint_of[joint.idx_v : joint.idx_v + joint.nv] = j
    above = np.zeros((model.njoints, model.njoints))
    for j in range(model.njoints):
        above[list(model.supports[j]), j] = 1.0
    np.fill_diagonal(above, 0.5)
    order = above[np.ix_(joint_of, joint_of)]
    moved = above[np.ix_(joint_of, np.array(carriers, dtype=np.intp))] > 0.0
    return order, moved.astype(np.float64)


def ancestry_of(couplings: Couplings, nv: int) -> Array:
    """1 where a joint follows an independent one, or is it, shape (nv, ny)."""
    ancestry = np.zeros((nv, len(couplings.v_index)))
    ancestry[couplings.v_index, np.arange(len(couplings.v_index))] = 1.0
    for pair in couplings.pairs:
        ancestry[pair.child_v] = ancestry[pair.parent_v]
    return ancestry


def q_of_v(model: pin.Model) -> Array:
    """Place in q of every velocity coordinate; those of free bodies get that of the body."""
    place = np.zeros(model.nv, dtype=np.intp)
    for joint in list(model.joints)[1:]:
        place[joint.idx_v : joint.idx_v + joint.nv] = joint.idx_q
    return place
