"""Export of a learned model as an ONNX file, in double precision and without torch."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError
from mbd_ros.features.identification.learn.training_samples import (
    CURVES,
    LEAST_INERTIA,
    Scales,
    energy_scale,
    inertia_scale,
)
from mbd_ros.methods.learned_model import ABOUT, SUM, ZEROS, About, signed

_OPSET = 17
_IR = 8  # version of the file format, which readers of some years ago support


def onnx_bytes(about: About, weights: Mapping[str, Array], scales: Scales, trust: Array) -> bytes:
    """Return the ONNX file of a model.

    Args:
        about: Description of the model.
        weights: Weights as in `network`, with members along the first axis.
        scales: Scales of inputs and outputs.
        trust: Factor of the torque of each joint, shape (m,). A structured model uses the smallest
            one for all joints, since its parts belong together.

    Returns:
    Returns:
        An ONNX file with inputs `position` and `velocity`, shape (m,), and outputs `torque` and
        `spread`, shape (m,); of a structured model with `inertia` and its rate, shape (m, m).
    """
    from onnx import TensorProto, helper

    m, graph = len(about.joints), _Graph()
    kind = TensorProto.DOUBLE
    if about.kind == "structured":
        _structured(graph, weights, scales, float(trust.min()))
        outputs = {"torque": [m], "spread": [m], "inertia": [m, m], "inertia_rate": [m, m]}
    else:
        _free(graph, weights, scales, trust)
        outputs = {"torque": [m], "spread": [m]}
    onnx_graph = helper.make_graph(
        graph.nodes,
        "learned_torque",
        [helper.make_tensor_value_info(name, kind, [m]) for name in ("position", "velocity")],
        [helper.make_tensor_value_info(name, kind, shape) for name, shape in outputs.items()],
        graph.constants,
    )
    model = helper.make_model(onnx_graph, opset_imports=[helper.make_opsetid("", _OPSET)])
    model.ir_version = _IR
    helper.set_model_props(model, {ABOUT: about.text(), SUM: ZEROS})
    try:
        return signed(model.SerializeToString())
    except ValueError as error:
        raise SolveError(f"{about.scene}: the model cannot be written: {error}") from error


class _Graph:
    """Builder of an ONNX graph; each call adds one node."""

    def __init__(self) -> None:
        from onnx import helper, numpy_helper

        self._make_node = helper.make_node
        self._make_tensor = numpy_helper.from_array
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, values: Any, kind: Any = np.float64) -> str:
        """Add an array, and return its name."""
        name = f"c{len(self.constants)}"
        self.constants.append(self._make_tensor(np.ascontiguousarray(values, dtype=kind), name))
        return name

    def __call__(self, operator: str, *inputs: Any, name: str = "", **attributes: Any) -> str:
        """Add an operator, and return the name of its result; arrays become constants."""
        names = [i if isinstance(i, str) else self.constant(i) for i in inputs]
        output = name or f"n{len(self.nodes)}"
        self.nodes.append(self._make_node(operator, names, [output], **attributes))
        return output

    def reshape(self, value: str, *shape: int) -> str:
        """Add a change of shape, and return the name of its result."""
        return self("Reshape", value, self.constant(shape, np.int64))

    def transpose(self, value: str, *order: int) -> str:
        """Add a permutation of axes, and return the name of its result."""
        return self("Transpose", value, perm=order)


def _structured(graph: _Graph, w: Mapping[str, Array], scales: Scales, trust: float) -> None:
    """Add C v + dV/dq + friction, M and its rate, with the equations of `network.Structured`."""
    members, m = w["offset"].shape
    D = inertia_scale(scales)
    sine, cosine = graph("Sin", "position"), graph("Cos", "position")
    x = graph.reshape(graph("Concat", sine, cosine, axis=0), 1, 2 * m, 1)
    rising, falling = (
        graph("Mul", w["W1"][..., k : k + m], s) for k, s in ((0, cosine), (m, sine))
    )
    g, J = _hidden(graph, w, x, graph("Sub", rising, falling))
    place = _triangle_placement(m)  # of the entries of L in an m x m matrix
    L = graph("Add", graph("MatMul", place @ w["W3"][:, :-1], g), _column(place, w["b3"]))
    L = graph.reshape(L, members, m, m)
    dL = graph("MatMul", place @ w["W3"][:, :-1], J)  # (members, m * m, m)
    v = graph.reshape("velocity", 1, m, 1)
    u = graph("Mul", v, D[:, None])
    Ldot = graph.reshape(graph("MatMul", dL, v), members, m, m)
    Lt_u = graph("MatMul", graph.transpose(L, 0, 2, 1), u)  # L' u, (members, m, 1)
    rate = graph("MatMul", graph.transpose(Ldot, 0, 2, 1), u)
    rate = graph("Add", graph("MatMul", Ldot, Lt_u), graph("MatMul", L, rate))
    outer = graph("MatMul", u, graph.transpose(Lt_u, 0, 2, 1))  # u_i (L' u)_j
    half = graph("MatMul", graph.reshape(outer, members, 1, m * m), dL)
    half = graph.transpose(half, 0, 2, 1)
    slope = graph("MatMul", w["W3"][:, -1:], J)
    slope = graph("Mul", graph.transpose(slope, 0, 2, 1), np.full((1, 1, 1), energy_scale(scales)))
    total = graph("Add", graph("Sub", graph("Mul", rate, D[:, None]), half), slope)
    torque = graph("Add", graph.reshape(total, members, m), _friction(graph, w, scales))
    _spread(graph, graph("Mul", torque, np.array(trust)))
    size = trust * np.outer(D, D)
    M = graph("MatMul", L, graph.transpose(L, 0, 2, 1))
    M = graph("Add", graph("ReduceMean", M, axes=[0], keepdims=0), LEAST_INERTIA * np.eye(m))
    graph("Mul", M, size, name="inertia")
    half_rate = graph("MatMul", Ldot, graph.transpose(L, 0, 2, 1))
    both = graph("Add", half_rate, graph.transpose(half_rate, 0, 2, 1))
    graph("Mul", graph("ReduceMean", both, axes=[0], keepdims=0), size, name="inertia_rate")


def _hidden(graph: _Graph, w: Mapping[str, Array], x: str, slopes: str) -> tuple[str, str]:
    """Add hidden layers (members, h, 1), and their derivatives (members, h, m) if asked for."""
    h = graph("Tanh", graph("Add", graph("MatMul", w["W1"], x), w["b1"][..., None]))
    g = graph("Tanh", graph("Add", graph("MatMul", w["W2"], h), w["b2"][..., None]))
    if not slopes:
        return g, ""
    ones = np.ones((1, 1, 1))
    J = graph("Mul", graph("Sub", ones, graph("Mul", h, h)), slopes)
    J = graph("MatMul", w["W2"], J)
    return g, graph("Mul", graph("Sub", ones, graph("Mul", g, g)), J)


def _triangle_placement(m: int) -> Array:
    """Return the 0-1 matrix from the entries of a lower triangle to its m x m matrix."""
    rows, columns = np.tril_indices(m)
    placement = np.zeros((m * m, len(rows)))
    placement[rows * m + columns, np.arange(len(rows))] = 1.0
    return placement


def _column(place: Array, b: Array) -> Array:
    return np.asarray((b[:, :-1] @ place.T)[..., None])


def _friction(graph: _Graph, w: Mapping[str, Array], scales: Scales) -> str:
    """Add the friction of each joint, shape (members, m)."""
    weights = np.logaddexp(0.0, w["friction"]) * scales.torque[:, None]
    ratio = graph("Div", "velocity", scales.v)
    friction = graph("Mul", ratio, weights[:, :, -1])
    for i, bend in enumerate(CURVES):
        curve = graph("Tanh", graph("Div", ratio, np.array(bend)))
        friction = graph("Add", friction, graph("Mul", curve, weights[:, :, i]))
    return graph("Add", friction, w["offset"] * scales.torque)


def _spread(graph: _Graph, torque: str) -> None:
    """Add mean and standard deviation over the members."""
    mean = graph("ReduceMean", torque, name="torque", axes=[0], keepdims=0)
    deviation = graph("Sub", torque, mean)
    square = graph("ReduceMean", graph("Mul", deviation, deviation), axes=[0], keepdims=0)
    graph("Sqrt", square, name="spread")


def _free(graph: _Graph, w: Mapping[str, Array], scales: Scales, trust: Array) -> None:
    members, m = w["b3"].shape
    q = graph("Div", graph("Sub", "position", scales.centre), scales.q)
    v = graph("Div", "velocity", scales.v)
    slow = graph("Tanh", graph("Div", "velocity", scales.slow))
    x = graph.reshape(graph("Concat", q, v, slow, axis=0), 1, 3 * m, 1)
    h, _ = _hidden(graph, w, x, "")
    output = graph("Add", graph("MatMul", w["W3"], h), w["b3"][..., None])
    torque = graph("Mul", graph.reshape(output, members, m), trust * scales.torque)
    _spread(graph, torque)
