"""Torque of a neural network that was trained on what the equations of motion do not explain."""

from collections.abc import Sequence
from functools import cache
from typing import Annotated, Any

import numpy as np

from mbd_ros.core.contracts import Load, Now, Output, Value
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.model.robot import Robot
from mbd_ros.core.ranges import Positive, Unit
from mbd_ros.core.state import Array, State
from mbd_ros.errors import ModelError, install_hint
from mbd_ros.methods.learned_model import (
    FADE,
    LARGEST,
    About,
    Corrections,
    LearnedFile,
    TrainingRange,
    about,
    check_robot,
)
from mbd_ros.methods.network_graph import check_graph

_MOST_MEMORY = 1_000_000_000  # bytes
_INPUTS = ("position", "velocity")
_TORQUE, _SPREAD, _INERTIA = "torque", "spread", "inertia"


class LearnedTorque(Load):
    """Learned difference between measured torques and the equations of motion.

        f = -s(q, v) r(q, v) - s(q) M(q) a - c(q, v, a)

    r and M are outputs of a neural network, which `mbd-ros learn` trains and writes to a file. A
    file belongs to the robot that it was trained on; only structured models have M. The weight s
    is 1 inside the box of positions and velocities that the training data covered and fades to 0
    outside of it. Adapted models also have corrections c of inertias, friction and stiffness,
    which hold everywhere. Effects of temperature and wear are left out.

    Args:
        model: File that `mbd-ros learn` has written, relative to the scene.
        fade: Width of the range in which s fades, relative to half of the trained range.

    Attributes:
        file: Name of the file.
        description: Description of the network that the file contains.

    Raises:
        ModelError: The file is damaged, has another version or belongs to another robot; or
            onnxruntime is not installed.
    """

    example = {"model": "package://mbd_ros/config/learned/prosthetic_leg.onnx"}
    outputs = (Output("share", ""), Output("spread", "N·m or N"))

    def __init__(
        self,
        robot: Robot,
        *,
        model: LearnedFile,
        fade: Annotated[Positive, Unit("-")] = FADE,
    ) -> None:
        description = about(model)
        self.file = model.name
        self.description = description
        check_robot(model.name, description, robot)
        self.joints = description.joints
        self._nv = int(robot.model.nv)
        joints = [robot.joint(name) for name in description.joints]
        self._q = [joint.q for joint in joints]
        self._v = [joint.v for joint in joints]
        self._matrix_entries = np.ix_(self._v, self._v)
        self._range = TrainingRange(description.low, description.high, fade)
        m = len(joints)
        self._position_range = TrainingRange(description.low[:m], description.high[:m], fade)
        self._session = _session(model, description)
        self._has_matrix = description.kind == "structured"
        self._corrections = Corrections(
            robot, description.bodies, description.friction, description.stiffness
        )
        self.has_inertia = self._has_matrix or self._corrections.has_inertia
        self._titles = [
            *(f"position of {name}" for name in description.joints),
            *(f"velocity of {name}" for name in description.joints),
        ]

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Return the generalized force, shape (nv,)."""
        tau = -self._corrections.torque(x.q, x.v)
        values = self._values(x)
        share = self._range.share(values)
        if share > 0.0:
            tau[self._v] -= share * self._run_network(values, _TORQUE)
        return tau

    def inertia(self, k: Kinematics, x: State) -> Array:
        """Return the inertia that acts on the joints, shape (nv, nv).

        M fades with the positions alone, since it is a function of them.
        """
        inertia, m = np.zeros((self._nv, self._nv)), len(self._q)
        if self._corrections.has_inertia:
            inertia = self._corrections.inertia(x.q)
        values = self._values(x)
        share = self._position_range.share(values[:m]) if self._has_matrix else 0.0
        if share > 0.0:
            inertia[self._matrix_entries] += share * self._run_network(values, _INERTIA)
        return inertia

    def potential(self, k: Kinematics, x: State) -> float:
        """Return the energy of the corrected inertias in gravity [J]."""
        return self._corrections.potential(x.q)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Return s, and the largest standard deviation of a torque among the networks."""
        values = self._values(x)
        spread = float(self._run_network(values, _SPREAD).max())
        return self._range.share(values), spread

    def doubt(self, x: State) -> str:
        """Name the position or velocity that is farthest outside of the trained range, or ""."""
        values = self._values(x)
        beyond = self._range.beyond(values)
        if not beyond.any():
            return ""
        farthest = self._titles[int(np.argmax(beyond))]
        share = 100.0 * self._range.share(values)
        return (
            f"{self.name}: {farthest} is outside of the trained range, {share:.0f} % of the "
            "learned torque acts"
        )

    def _values(self, x: State) -> Array:
        return np.array([*x.q[self._q], *x.v[self._v]], dtype=np.float64)

    def _run_network(self, values: Array, output: str) -> Array:
        m = len(self._q)
        inputs = dict(zip(_INPUTS, (values[:m], values[m:]), strict=True))
        results: list[Array] = self._session.run([output], inputs)
        return results[0]


def _session(model: LearnedFile, description: About) -> Any:
    """Load the network; it runs in one thread, since it is too small to gain from more.

    Raises:
        ModelError: The file is not a network of this form, or onnxruntime is not installed.
    """
    try:
        import onnxruntime
        from onnxruntime.capi import onnxruntime_pybind11_state as refusals
    except ImportError as error:
        raise ModelError(install_hint("onnxruntime")) from error
    if len(model.content) > LARGEST:
        raise ModelError(
            f"{model.name}: has {len(model.content)} bytes, at most {LARGEST} are accepted"
        )
    check_graph(model.name, model.content)
    _bound_memory(onnxruntime)
    options = onnxruntime.SessionOptions()
    options.add_session_config_entry("session.use_env_allocators", "1")
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    kinds = ("Fail", "InvalidProtobuf", "InvalidGraph", "InvalidArgument", "NotImplemented")
    refused = tuple(getattr(refusals, kind) for kind in (*kinds, "RuntimeException", "NoSuchFile"))
    try:
        session = onnxruntime.InferenceSession(
            model.content, options, providers=["CPUExecutionProvider"]
        )
        _check_answer(session, description)
    except (*refused, ValueError, RuntimeError) as error:
        raise ModelError(f"{model.name}: the network cannot be evaluated: {error}") from error
    return session


@cache
def _bound_memory(onnxruntime: Any) -> None:
    """Limit the memory of all networks of this process; a small file can describe huge arrays."""
    kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
    place = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, onnxruntime.OrtMemType.DEFAULT)
    arena = onnxruntime.OrtArenaCfg({"max_mem": _MOST_MEMORY})
    onnxruntime.create_and_register_allocator(place, arena)


def _check_answer(session: Any, description: About) -> None:
    """Refuse a network whose outputs do not have the shapes of its joints."""
    m = len(description.joints)
    shapes = {_TORQUE: (m,), _SPREAD: (m,)}
    if description.kind == "structured":
        shapes[_INERTIA] = (m, m)
    middle = 0.5 * (description.low + description.high)
    inputs = dict(zip(_INPUTS, (middle[:m], middle[m:]), strict=True))
    for (name, shape), value in zip(shapes.items(), session.run([*shapes], inputs), strict=True):
        if value.shape != shape or value.dtype != np.float64 or not np.isfinite(value).all():
            raise ValueError(f"its output '{name}' must be finite numbers of shape {shape}")
