"""Torque that a model has learned beside the equations of motion."""

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
from mbd_ros.methods.learned import (
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
    """f = -s(q, v) r(q, v) - s(q) M(q) a - c(q, v, a): what drives need beside the equations.

    The network is a file of `mbd-ros learn` and belongs to the robot that it was learned on. M is
    there in structured models only. s is 1 where the network has learned and fades to 0 outside of
    that box of positions and velocities. c are corrections of inertias, friction and stiffness,
    which adapted models have; they hold everywhere, as physics does. It knows nothing of
    temperature or wear.

    Args:
        model: File of `mbd-ros learn`, relative to the scene.
        fade: Width in which it fades, over half of what a position or velocity spanned.

    Attributes:
        file: Name of the file.
        said: What it says of itself.

    Raises:
        ModelError: The file is damaged, of another version, or of another robot; or onnxruntime
            is not installed.
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
        self.file, self.said = model.name, (said := about(model))
        check_robot(model.name, said, robot)
        self.joints = said.joints
        self._nv = int(robot.model.nv)
        joints = [robot.joint(name) for name in said.joints]
        self._q = [joint.q for joint in joints]
        self._v = [joint.v for joint in joints]
        self._box = np.ix_(self._v, self._v)
        self._range = TrainingRange(said.low, said.high, fade)
        m = len(joints)
        self._places = TrainingRange(said.low[:m], said.high[:m], fade)
        self._session = _session(model, said)
        self._has_matrix = said.kind == "structured"
        self._corrections = Corrections(robot, said.bodies, said.friction, said.stiffness)
        self.has_inertia = self._has_matrix or self._corrections.has_inertia
        self._titles = [
            *(f"position of {name}" for name in said.joints),
            *(f"velocity of {name}" for name in said.joints),
        ]

    def force(self, k: Kinematics, x: State, u: Array) -> Array:
        """Generalized force, shape (nv,)."""
        tau = -self._corrections.torque(x.q, x.v)
        values = self._values(x)
        share = self._range.share(values)
        if share > 0.0:
            tau[self._v] -= share * self._asked(values, _TORQUE)
        return tau

    def inertia(self, k: Kinematics, x: State) -> Array:
        """M on the joints, shape (nv, nv); it fades with positions alone, of which it is one."""
        found, m = np.zeros((self._nv, self._nv)), len(self._q)
        if self._corrections.has_inertia:
            found = self._corrections.inertia(x.q)
        values = self._values(x)
        share = self._places.share(values[:m]) if self._has_matrix else 0.0
        if share > 0.0:
            found[self._box] += share * self._asked(values, _INERTIA)
        return found

    def potential(self, k: Kinematics, x: State) -> float:
        """Energy of corrected inertias in gravity [J]."""
        return self._corrections.potential(x.q)

    def show(self, k: Kinematics, x: State, u: Array, now: Now) -> Sequence[Value]:
        """Trust, and the largest standard deviation of a torque among the networks."""
        values = self._values(x)
        spread = float(self._asked(values, _SPREAD).max())
        return self._range.share(values), spread

    def doubt(self, x: State) -> str:
        """Which position or velocity is outside of what was learned from."""
        values = self._values(x)
        beyond = self._range.beyond(values)
        if not beyond.any():
            return ""
        far = self._titles[int(np.argmax(beyond))]
        share = 100.0 * self._range.share(values)
        return f"{self.name}: {far} is outside of what was learned from, {share:.0f} % of it acts"

    def _values(self, x: State) -> Array:
        return np.array([*x.q[self._q], *x.v[self._v]], dtype=np.float64)

    def _asked(self, values: Array, output: str) -> Array:
        m = len(self._q)
        inputs = dict(zip(_INPUTS, (values[:m], values[m:]), strict=True))
        (found,) = self._session.run([output], inputs)
        result: Array = found
        return result


def _session(model: LearnedFile, said: About) -> Any:
    """The network, ready to be asked; one thread, since threads cost more than it takes.

    Raises:
        ModelError: It is no network of this form, or onnxruntime is not installed.
    """
    try:
        import onnxruntime
        from onnxruntime.capi import onnxruntime_pybind11_state as refusals
    except ImportError as error:
        raise ModelError(install_hint("onnxruntime")) from error
    if len(model.content) > LARGEST:
        raise ModelError(f"{model.name}: {len(model.content)} bytes, accepted are {LARGEST}")
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
        _check_answer(session, said)
    except (*refused, ValueError, RuntimeError) as error:
        raise ModelError(f"{model.name}: the network cannot be asked: {error}") from error
    return session


@cache
def _bound_memory(onnxruntime: Any) -> None:
    """Bound what all networks of this process take: small numbers can have large products."""
    kind = onnxruntime.OrtAllocatorType.ORT_ARENA_ALLOCATOR
    place = onnxruntime.OrtMemoryInfo("Cpu", kind, 0, onnxruntime.OrtMemType.DEFAULT)
    arena = onnxruntime.OrtArenaCfg({"max_mem": _MOST_MEMORY})
    onnxruntime.create_and_register_allocator(place, arena)


def _check_answer(session: Any, said: About) -> None:
    """Refuse a network that does not answer in the shapes of its joints."""
    m = len(said.joints)
    shapes = {_TORQUE: (m,), _SPREAD: (m,)}
    if said.kind == "structured":
        shapes[_INERTIA] = (m, m)
    middle = 0.5 * (said.low + said.high)
    inputs = dict(zip(_INPUTS, (middle[:m], middle[m:]), strict=True))
    for (name, shape), found in zip(shapes.items(), session.run([*shapes], inputs), strict=True):
        if found.shape != shape or found.dtype != np.float64 or not np.isfinite(found).all():
            raise ValueError(f"its output '{name}' is not {shape} finite numbers")
