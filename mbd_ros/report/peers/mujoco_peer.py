"""MuJoCo on the scenes of this package; the only importer of mujoco."""

from collections.abc import Iterator, Sequence

import mujoco
import numpy as np

from mbd_ros.core.state import State
from mbd_ros.errors import DivergedError
from mbd_ros.report.peers.contenders import Task, cpu_time
from mbd_ros.report.precision.rungs import Record

SETUP = (
    "MuJoCo: RK4 with steps from 10 ms; equality constraints with solref (T, 1), T from 2 dt down "
    "to 0.38 dt with refsafe off (at 0.34 dt every run diverges), and solimp 0.9999 to the end; "
    "with and without the exact diagonal of their inertia; Newton solver to 1e-10; contacts, "
    "limits, sensors and islands off; all steps between two samples are one call of mj_step."
)
_SHARES = (2.0, 1.0, 0.7, 0.5, 0.4, 0.38)  # time constant of constraints in steps
_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)  # s
_OTHERS = ("mjINT_EULER", "mjINT_IMPLICITFAST", "mjINT_IMPLICIT", "mjINT_DISCRETE")
_OFF = ("CONTACT", "LIMIT", "SENSOR", "ISLAND", "REFSAFE", "AUTORESET")
_SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)


class MujocoRun:
    """One integrator, step and stiffness.

    Args:
        task: The scene.
        integrator: Name in `mjtIntegrator`.
        dt: Step [s].
        share: Time constant of the constraints in steps.
        is_exact: Whether the diagonal of the inertia of constraints is computed exactly.
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
        joints = [self._model.joint(name) for name in task.names]
        self._q = np.array([int(joint.qposadr[0]) for joint in joints])
        self._v = np.array([int(joint.dofadr[0]) for joint in joints])
        self.setup = integrator.removeprefix("mjINT_")
        if task.couplings or task.loops:
            self.setup += f", T = {share:g} dt{', exact diagonal' if is_exact else ''}"
        self.record: Record = {"dt": dt}

    def run(self, times: Sequence[float]) -> tuple[list[State], float]:
        """As `Contender.run`.

        Raises:
            DivergedError: MuJoCo warns of huge or infinite numbers.
        """
        mujoco.set_mju_user_warning(lambda _: None)  # it would go to a file where we stand
        data, states, used, done = mujoco.MjData(self._model), [], 0.0, 0
        data.qpos[self._q], data.qvel[self._v] = self._task.q, self._task.v
        for t in times:
            steps = round(t / self._dt) - done
            used += cpu_time(lambda n=steps: mujoco.mj_step(self._model, data, n))
            done += steps
            if any(warning.number for warning in data.warning):
                raise DivergedError(f"MuJoCo warns before {t:g} s")
            states.append(State(t, data.qpos[self._q], data.qvel[self._v]))
        return states, used


def runs(task: Task, quick: bool) -> Iterator[MujocoRun]:
    """The sweep over integrators, steps and stiffnesses."""
    has_rows = bool(task.couplings or task.loops)
    steps = _STEPS[2:6] if quick else _STEPS
    for dt in steps:
        for share in _SHARES if has_rows else (2.0,):
            for is_exact in (False, True) if has_rows else (False,):
                yield MujocoRun(task, "mjINT_RK4", dt, share, is_exact)
    for name in _OTHERS:
        if hasattr(mujoco.mjtIntegrator, name):
            yield from (MujocoRun(task, name, dt) for dt in steps[1::2])


def _model(task: Task, time_constant: float) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(task.urdf)
    spec.option.gravity = task.gravity
    for joint in spec.joints:
        joint.limited = False
    for child, parent, factor, offset in task.couplings:
        equality = spec.add_equality()
        equality.type = mujoco.mjtEq.mjEQ_JOINT
        equality.name1, equality.name2 = child, parent
        equality.data[:5] = [offset, factor, 0.0, 0.0, 0.0]
    for i, loop in enumerate(task.loops):
        equality = spec.add_equality()
        equality.type, equality.objtype = mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtObj.mjOBJ_SITE
        equality.name1, equality.name2 = f"a{i}", f"b{i}"
        spec.body(loop.frame_a).add_site(name=f"a{i}", pos=loop.point_a)
        spec.body(loop.frame_b).add_site(name=f"b{i}", pos=loop.point_b)
    for equality in spec.equalities:
        equality.solref[:], equality.solimp[:] = (time_constant, 1.0), _SOLIMP
    return spec.compile()
