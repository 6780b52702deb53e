"""MuJoCo on the scenes of this package; the only importer of mujoco."""

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.peers.contenders import cpu_time
from mbd_ros.applications.report.peers.translation import Body, End, Follow, Task
from mbd_ros.applications.report.precision.converged import Record
from mbd_ros.core.state import Array, State
from mbd_ros.errors import DivergedError, SceneError

SETUP = (
    "MuJoCo: RK4 with steps from 0.1 s; equality constraints with solref (T, 1), T from 2 dt down "
    "to 0.38 dt with refsafe off (at 0.34 dt every run diverges), and solimp 0.9999 to the end; "
    "with and without the exact diagonal of their inertia; Newton solver to 1e-10; contacts, "
    "limits, sensors and islands off; all steps between two samples are one call of mj_step. "
    "Links without mass or moments get 1e-12 of those of the robot: MuJoCo refuses them."
)
_SHARES = (2.0, 1.0, 0.7, 0.5, 0.4, 0.38)  # time constant of constraints in steps
_STEPS = (0.1, 5e-2, 2e-2, 1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)  # s
_OTHERS = ("mjINT_EULER", "mjINT_IMPLICITFAST", "mjINT_IMPLICIT", "mjINT_DISCRETE")
_OFF = ("CONTACT", "LIMIT", "SENSOR", "ISLAND", "REFSAFE", "AUTORESET")
_SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
_HIGHEST = 4  # power of a coupling
_LEAST, _NEARLY_NOTHING = 1e-12, 1e-14  # of mass and moments, relative; and absolute [SI]
_WXYZ = [3, 0, 1, 2]


class MujocoRun:
    """One integrator, step and stiffness.

    Args:
        integrator: Name in `mjtIntegrator`.
        dt: Step [s].
        share: Time constant of the constraints in steps.
        is_exact: Whether the diagonal of the inertia of constraints is computed exactly.

    Raises:
        SceneError: MuJoCo cannot express the scene.
    """

    package = "MuJoCo"

    def __init__(
        self, task: Task, integrator: str, dt: float, share: float = 2.0, is_exact: bool = False
    ) -> None:
        self._task, self._dt = task, dt
        self._model = _model(task, share * dt)
        options = self._model.opt
        options.integrator = getattr(mujoco.mjtIntegrator, integrator)
        options.timestep, options.tolerance = dt, 1e-10
        for name in _OFF:
            options.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{name}")
        if is_exact:
            options.enableflags |= mujoco.mjtEnableBit.mjENBL_DIAGEXACT
        self._q, self._v = _coordinates(task, self._model)
        self.setup = integrator.removeprefix("mjINT_")
        if task.has_rows:
            self.setup += f", T = {share:g} dt{', exact diagonal' if is_exact else ''}"
        self.record: Record = {"dt": dt}

    def run(self, times: Sequence[float]) -> tuple[list[State], float]:
        """Return the states at the samples, and the CPU time of the integration [s].

        Raises:
            DivergedError: MuJoCo warns of huge or infinite numbers.
        """
        mujoco.set_mju_user_warning(lambda _: None)  # it would go to a file where we stand
        data, states, used, done = mujoco.MjData(self._model), [], 0.0, 0
        data.qpos[self._q], data.qvel[self._v] = _to_mujoco(self._task)
        data.qfrc_applied[self._v] = self._task.torques
        for t in times:
            steps = round(t / self._dt) - done
            used += cpu_time(lambda n=steps: mujoco.mj_step(self._model, data, n))
            done += steps
            if any(warning.number for warning in data.warning):
                raise DivergedError(f"MuJoCo warns before {t:g} s")
            q, v = data.qpos[self._q], data.qvel[self._v]
            states.append(State(t, *_from_mujoco(self._task, q, v)))
        return states, used


def runs(task: Task, quick: bool) -> Iterator[MujocoRun]:
    """The sweep over integrators, steps and stiffnesses."""
    steps = _STEPS[5:9] if quick else _STEPS
    for dt in steps:
        for share in _SHARES if task.has_rows else (2.0,):
            for is_exact in (False, True) if task.has_rows else (False,):
                yield MujocoRun(task, "mjINT_RK4", dt, share, is_exact)
    for name in _OTHERS:
        if hasattr(mujoco.mjtIntegrator, name):
            yield from (MujocoRun(task, name, dt) for dt in steps[1::2])


def _model(task: Task, time_constant: float) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.option.gravity = task.gravity
    bodies, least = [spec.worldbody], _least_inertia(task)
    for body in task.moving:
        bodies.append(_add_body(bodies[body.parent], body, least))
    for follow in task.follows:
        _add_coupling(spec, task, follow)
    sites = _Sites(bodies)
    for kind, pairs in (("CONNECT", task.points), ("WELD", task.welds)):
        for a, b in pairs:
            equality = spec.add_equality(
                type=getattr(mujoco.mjtEq, f"mjEQ_{kind}"), objtype=mujoco.mjtObj.mjOBJ_SITE
            )
            equality.name1, equality.name2 = sites.add(a), sites.add(b)
    for a, b, distance in task.bars:
        tendon = _add_tendon(spec, sites.add(a), sites.add(b))
        equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_TENDON, name1=tendon.name)
        equality.data[:5] = [distance - _length(task, a, b), 0.0, 0.0, 0.0, 0.0]
    for a, b, stiffness, damping, length in task.springs:
        tendon = _add_tendon(spec, sites.add(a), sites.add(b))
        tendon.stiffness, tendon.damping = _linear(stiffness, tendon), _linear(damping, tendon)
        tendon.springlength = [length, length]
    for equality in spec.equalities:
        equality.solref[:], equality.solimp[:] = (time_constant, 1.0), _SOLIMP
    try:
        return spec.compile()
    except ValueError as error:
        raise SceneError(str(error).splitlines()[0]) from error


def _least_inertia(task: Task) -> Any:
    """Inertia of a link without mass."""
    mass = _LEAST * sum(body.inertia.mass for body in task.moving)
    size = sum(float(np.linalg.norm(body.place.translation)) for body in task.moving)
    moment = max(mass * size**2, _NEARLY_NOTHING)
    return pin.Inertia(max(mass, _NEARLY_NOTHING), np.zeros(3), moment * np.eye(3))


def _add_body(parent: Any, spec: Body, least: Any) -> Any:
    place, inertia = spec.place, spec.inertia
    if inertia.mass < least.mass:
        inertia = least
    elif np.linalg.eigvalsh(inertia.inertia)[0] < least.inertia[0, 0]:
        inertia = pin.Inertia(inertia.mass, inertia.lever, inertia.inertia + least.inertia)
    quaternion = pin.Quaternion(place.rotation).coeffs()[_WXYZ]
    body = parent.add_body(name=spec.name, pos=place.translation, quat=quaternion)
    body.explicitinertial, body.mass, body.ipos = True, inertia.mass, inertia.lever
    moments = inertia.inertia
    body.fullinertia = [*np.diag(moments), moments[0, 1], moments[0, 2], moments[1, 2]]
    if not spec.axis.any():
        body.add_freejoint(name=spec.name)
        return body
    kind = mujoco.mjtJoint.mjJNT_SLIDE if spec.slides else mujoco.mjtJoint.mjJNT_HINGE
    joint = body.add_joint(name=spec.name, type=kind, axis=spec.axis, armature=spec.armature)
    joint.springref = spec.rest
    joint.stiffness = _linear(spec.stiffness, joint)
    joint.damping = _linear(spec.damping, joint)
    return body


def _add_coupling(spec: Any, task: Task, follow: Follow) -> None:
    coefficients = follow.coefficients
    if len(coefficients) > _HIGHEST + 1:
        highest = len(coefficients) - 1
        raise SceneError(f"couplings of power {highest}, it takes {_HIGHEST}")
    child, parent = task.bodies[follow.child], task.bodies[follow.parent]
    equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT)
    equality.name1, equality.name2 = child.name, parent.name
    equality.data[: _HIGHEST + 1] = np.pad(coefficients, (0, _HIGHEST + 1 - len(coefficients)))


def _add_tendon(spec: Any, *sites: str) -> Any:
    tendon = spec.add_tendon(name=f"tendon{len(spec.tendons)}")
    for site in sites:
        tendon.wrap_site(site)
    return tendon


def _length(task: Task, a: End, b: End) -> float:
    """Distance of two ends with every joint at 0 [m]: MuJoCo counts from there."""
    places = [pin.SE3.Identity()]
    for body in task.moving:
        places.append(places[body.parent] * body.place)
    ends = (places[end.body] * end.place for end in (a, b))
    return float(np.linalg.norm(next(ends).translation - next(ends).translation))


def _linear(value: float, part: Any) -> Any:
    """A coefficient where MuJoCo has polynomials since 4.0."""
    count = np.size(part.stiffness)
    return value if count == 1 else [value, *([0.0] * (count - 1))]


class _Sites:
    """Frames on bodies, by name."""

    def __init__(self, bodies: Sequence[Any]) -> None:
        self._bodies, self._count = bodies, 0

    def add(self, end: End) -> str:
        """A new site; its name."""
        self._count += 1
        name, place = f"site{self._count}", end.place
        quaternion = pin.Quaternion(place.rotation).coeffs()[_WXYZ]
        self._bodies[end.body].add_site(name=name, pos=place.translation, quat=quaternion)
        return name


def _coordinates(task: Task, model: mujoco.MjModel) -> tuple[Array, Array]:
    """Where our coordinates and velocities stand in those of MuJoCo."""
    joints = [model.joint(body.name) for body in task.joints]
    q, v = [int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints]
    if task.is_floating:
        free = model.joint(task.moving[0].name)
        q = [*(int(free.qposadr[0]) + i for i in (0, 1, 2, 4, 5, 6, 3)), *q]
        v = [*(int(free.dofadr[0]) + i for i in range(6)), *v]
    return np.array(q), np.array(v)


def _to_mujoco(task: Task) -> tuple[Array, Array]:
    """The start: MuJoCo's free velocity is linear in the world, then angular in the body."""
    v = task.v.copy()
    if task.is_floating:
        v[:3] = pin.XYZQUATToSE3(task.q[:7]).rotation.dot(v[:3])
    return task.q, v


def _from_mujoco(task: Task, q: Array, v: Array) -> tuple[Array, Array]:
    if task.is_floating:
        v[:3] = pin.XYZQUATToSE3(q[:7]).rotation.T.dot(v[:3])
    return q, v
