"""A learned model as an ONNX file, written from its weights: no torch, double precision."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbd_ros.core.state import Array
from mbd_ros.errors import SolveError
from mbd_ros.features.identification.learn.training_samples import (
    CURVES,
    LEAST_INERTIA,
    Scales,
    usual_energy,
    usual_inertia,
)
from mbd_ros.methods.learned import ABOUT, SUM, ZEROS, About, signed

_OPSET = 17
_IR = 8  # of the file format: what readers of some years ago know


def onnx_of(said: About, weights: Mapping[str, Array], scales: Scales, trust: Array) -> bytes:
    """The file of a model.

    Args:
        said: What it says of itself.
        weights: As in `network`, members first.
        scales: Of inputs and outputs.
        trust: Share of the torque of each joint that is given, shape (m,); one for all joints of
            a structured model, whose parts belong together.

    Returns:
        An ONNX file with inputs `position` and `velocity`, shape (m,), and outputs `torque` and
        `spread`, shape (m,); of a structured model with `inertia` and its rate, shape (m, m).
    """
    from onnx import TensorProto, helper

    m, graph = len(said.joints), _Graph()
    kind = TensorProto.DOUBLE
    if said.kind == "structured":
        _structured(graph, weights, scales, float(trust.min()))
        outputs = {"torque": [m], "spread": [m], "inertia": [m, m], "inertia_rate": [m, m]}
    else:
        _free(graph, weights, scales, trust)
        outputs = {"torque": [m], "spread": [m]}
    made = helper.make_graph(
        graph.nodes,
        "learned_torque",
        [helper.make_tensor_value_info(name, kind, [m]) for name in ("position", "velocity")],
        [helper.make_tensor_value_info(name, kind, shape) for name, shape in outputs.items()],
        graph.constants,
    )
    model = helper.make_model(made, opset_imports=[helper.make_opsetid("", _OPSET)])
    model.ir_version = _IR
    helper.set_model_props(model, {ABOUT: said.text(), SUM: ZEROS})
    try:
        return signed(model.SerializeToString())
    except ValueError as error:
        raise SolveError(f"{said.scene}: the model cannot be written: {error}") from error


class _Graph:
    """Nodes of a graph as they are written down, one a line."""

    def __init__(self) -> None:
        from onnx import helper, numpy_helper

        self._node, self._tensor = helper.make_node, numpy_helper.from_array
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def constant(self, values: Any, kind: Any = np.float64) -> str:
        """Name of an array."""
        name = f"c{len(self.constants)}"
        self.constants.append(self._tensor(np.ascontiguousarray(values, dtype=kind), name))
        return name

    def __call__(self, operator: str, *inputs: Any, name: str = "", **more: Any) -> str:
        """Name of the result of an operator; arrays among its inputs become constants."""
        given = [one if isinstance(one, str) else self.constant(one) for one in inputs]
        output = name or f"n{len(self.nodes)}"
        self.nodes.append(self._node(operator, given, [output], **more))
        return output

    def shaped(self, value: str, *shape: int) -> str:
        """The same numbers in another shape."""
        return self("Reshape", value, self.constant(shape, np.int64))

    def turned(self, value: str, *order: int) -> str:
        """The same numbers with other axes first."""
        return self("Transpose", value, perm=order)


def _structured(graph: _Graph, w: Mapping[str, Array], scales: Scales, trust: float) -> None:
    """Bias C v + dV/dq + friction, M and its rate; equations as in `network.Structured`."""
    members, m = w["offset"].shape
    D = usual_inertia(scales)
    sine, cosine = graph("Sin", "position"), graph("Cos", "position")
    x = graph.shaped(graph("Concat", sine, cosine, axis=0), 1, 2 * m, 1)
    rising, falling = (
        graph("Mul", w["W1"][..., k : k + m], s) for k, s in ((0, cosine), (m, sine))
    )
    g, J = _hidden(graph, w, x, graph("Sub", rising, falling))
    place = _places(m)  # of the entries of L in an m x m matrix
    L = graph("Add", graph("MatMul", place @ w["W3"][:, :-1], g), _column(place, w["b3"]))
    L = graph.shaped(L, members, m, m)
    dL = graph("MatMul", place @ w["W3"][:, :-1], J)  # (members, m * m, m)
    v = graph.shaped("velocity", 1, m, 1)
    u = graph("Mul", v, D[:, None])
    Ldot = graph.shaped(graph("MatMul", dL, v), members, m, m)
    turned = graph("MatMul", graph.turned(L, 0, 2, 1), u)  # L' u, (members, m, 1)
    rate = graph("MatMul", graph.turned(Ldot, 0, 2, 1), u)
    rate = graph("Add", graph("MatMul", Ldot, turned), graph("MatMul", L, rate))
    outer = graph("MatMul", u, graph.turned(turned, 0, 2, 1))  # u_i (L' u)_j
    half = graph("MatMul", graph.shaped(outer, members, 1, m * m), dL)
    half = graph.turned(half, 0, 2, 1)
    slope = graph("MatMul", w["W3"][:, -1:], J)
    slope = graph("Mul", graph.turned(slope, 0, 2, 1), np.full((1, 1, 1), usual_energy(scales)))
    whole = graph("Add", graph("Sub", graph("Mul", rate, D[:, None]), half), slope)
    torque = graph("Add", graph.shaped(whole, members, m), _friction(graph, w, scales))
    _spread(graph, graph("Mul", torque, np.array(trust)))
    size = trust * np.outer(D, D)
    M = graph("MatMul", L, graph.turned(L, 0, 2, 1))
    M = graph("Add", graph("ReduceMean", M, axes=[0], keepdims=0), LEAST_INERTIA * np.eye(m))
    graph("Mul", M, size, name="inertia")
    half_rate = graph("MatMul", Ldot, graph.turned(L, 0, 2, 1))
    both = graph("Add", half_rate, graph.turned(half_rate, 0, 2, 1))
    graph("Mul", graph("ReduceMean", both, axes=[0], keepdims=0), size, name="inertia_rate")


def _hidden(graph: _Graph, w: Mapping[str, Array], x: str, slopes: str) -> tuple[str, str]:
    """Hidden layers (members, h, 1), and their derivatives (members, h, m) where slopes are."""
    h = graph("Tanh", graph("Add", graph("MatMul", w["W1"], x), w["b1"][..., None]))
    g = graph("Tanh", graph("Add", graph("MatMul", w["W2"], h), w["b2"][..., None]))
    if not slopes:
        return g, ""
    one = np.ones((1, 1, 1))
    J = graph("Mul", graph("Sub", one, graph("Mul", h, h)), slopes)
    J = graph("MatMul", w["W2"], J)
    return g, graph("Mul", graph("Sub", one, graph("Mul", g, g)), J)


def _places(m: int) -> Array:
    """0 and 1: entries of a lower triangle to the m x m of its matrix."""
    rows, columns = np.tril_indices(m)
    found = np.zeros((m * m, len(rows)))
    found[rows * m + columns, np.arange(len(rows))] = 1.0
    return found


def _column(place: Array, b: Array) -> Array:
    return np.asarray((b[:, :-1] @ place.T)[..., None])


def _friction(graph: _Graph, w: Mapping[str, Array], scales: Scales) -> str:
    """Friction of each joint, shape (members, m)."""
    weights = np.logaddexp(0.0, w["friction"]) * scales.torque[:, None]
    ratio = graph("Div", "velocity", scales.v)
    found = graph("Mul", ratio, weights[:, :, -1])
    for i, bend in enumerate(CURVES):
        curve = graph("Tanh", graph("Div", ratio, np.array(bend)))
        found = graph("Add", found, graph("Mul", curve, weights[:, :, i]))
    return graph("Add", found, w["offset"] * scales.torque)


def _spread(graph: _Graph, torque: str) -> None:
    """Mean and standard deviation over the members."""
    mean = graph("ReduceMean", torque, name="torque", axes=[0], keepdims=0)
    off = graph("Sub", torque, mean)
    square = graph("ReduceMean", graph("Mul", off, off), axes=[0], keepdims=0)
    graph("Sqrt", square, name="spread")


def _free(graph: _Graph, w: Mapping[str, Array], scales: Scales, trust: Array) -> None:
    members, m = w["b3"].shape
    q = graph("Div", graph("Sub", "position", scales.centre), scales.q)
    v = graph("Div", "velocity", scales.v)
    slow = graph("Tanh", graph("Div", "velocity", scales.slow))
    x = graph.shaped(graph("Concat", q, v, slow, axis=0), 1, 3 * m, 1)
    h, _ = _hidden(graph, w, x, "")
    said = graph("Add", graph("MatMul", w["W3"], h), w["b3"][..., None])
    torque = graph("Mul", graph.shaped(said, members, m), trust * scales.torque)
    _spread(graph, torque)
