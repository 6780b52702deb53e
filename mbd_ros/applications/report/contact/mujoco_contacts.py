"""MuJoCo on contact problems."""

from collections.abc import Iterator, Sequence
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from mbd_ros.applications.report.contact.problems import (
    GROUND,
    Problem,
    Solid,
    Trace,
    damping_ratio,
)
from mbd_ros.applications.report.peers.contenders import cpu_time
from mbd_ros.applications.report.precision.converged import Record
from mbd_ros.core.state import Array
from mbd_ros.errors import DivergedError

SETUP = (
    "MuJoCo: elliptic cones, Newton solver to 1e-12, refsafe off; Euler and RK4; time constants of"
    " contacts of 4, 2 and 1 steps with the damping ratio of the restitution, solimp 0.9999; "
    "impratio 1 and 1000, with 10 noslip iterations and without."
)
_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4)  # s
_SHARES = (4.0, 2.0, 1.0)  # time constant of contacts in steps
_SLIPS = ((1.0, 0), (1000.0, 0), (1000.0, 10))  # impratio, noslip iterations
_INTEGRATORS = ("EULER", "RK4")
_SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
_FOOT = 0.01  # m, radius of a foot
_ITERATIONS = 100
_XYZW, _WXYZ = [1, 2, 3, 0], [3, 0, 1, 2]


class MujocoContacts:
    """One integrator, step, stiffness and treatment of slip.

    Args:
        integrator: End of a name in `mjtIntegrator`.
        dt: Step [s].
        share: Time constant of contacts in steps.
        slip: impratio and iterations of the noslip solver.
    """

    package = "MuJoCo"

    def __init__(
        self,
        problem: Problem,
        integrator: str,
        dt: float,
        share: float = 2.0,
        slip: tuple[float, int] = (1.0, 0),
    ) -> None:
        self._problem, self._dt = problem, dt
        ratio = damping_ratio(problem.restitution)
        self._model = _model(problem, (share * dt / ratio, ratio))
        options = self._model.opt
        options.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}")
        options.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        options.timestep, options.tolerance, options.iterations = dt, 1e-12, _ITERATIONS
        options.impratio, options.noslip_iterations = slip
        options.noslip_tolerance = 1e-12
        options.disableflags |= mujoco.mjtDisableBit.mjDSBL_REFSAFE
        options.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.setup = f"{integrator}, T = {share:g} dt, impratio {slip[0]:g}, noslip {slip[1]}"
        self.record: Record = {"dt": dt}

    def run(self, times: Sequence[float]) -> tuple[Trace, float]:
        """States at the samples, and CPU time [s].

        Raises:
            DivergedError: MuJoCo warns of huge or infinite numbers.
        """
        mujoco.set_mju_user_warning(lambda _: None)  # it would go to a file where we stand
        model, data = self._model, mujoco.MjData(self._model)
        q, v = data.qpos.reshape(-1, 7), data.qvel.reshape(-1, 6)
        for i, solid in enumerate(self._problem.solids):
            v[i] = [*solid.v, *solid.spin]  # at the start their axes are those of the world
        states, used, done = [], 0.0, 0
        for t in times:
            steps = round(t / self._dt) - done
            used += cpu_time(lambda n=steps: mujoco.mj_step(model, data, n))
            done += steps
            if any(warning.number for warning in data.warning):
                raise DivergedError(f"MuJoCo warns before {t:g} s")
            turns = [pin.Quaternion(*each[3:]).matrix() for each in q]
            spins = [R.dot(each[3:]) for R, each in zip(turns, v, strict=True)]
            states.append((q[:, :3].copy(), v[:, :3].copy(), np.array(spins)))
        forces = _forces(self._problem, model, data)
        return Trace(*(np.array(part) for part in zip(*states, strict=True)), forces), used


def runs(problem: Problem, quick: bool) -> Iterator[MujocoContacts]:
    """The sweep over steps, stiffnesses and treatments of slip."""
    for dt in _STEPS[2:4] if quick else _STEPS:
        for integrator in _INTEGRATORS:
            for share in _SHARES[1:2] if quick else _SHARES:
                for slip in _SLIPS if problem.mu else _SLIPS[:1]:
                    yield MujocoContacts(problem, integrator, dt, share, slip)


def _model(problem: Problem, solref: tuple[float, float]) -> mujoco.MjModel:
    spec = mujoco.MjSpec()
    spec.option.gravity = problem.gravity
    plane = spec.worldbody.add_geom(name=GROUND, type=mujoco.mjtGeom.mjGEOM_PLANE)
    plane.size[:] = (1.0, 1.0, 1.0)
    geoms = [plane]
    for solid in problem.solids:
        geoms += _add(spec, solid)
    for geom in geoms:
        geom.condim, geom.friction[0] = 3, problem.mu
        geom.solref[:], geom.solimp[:] = solref, _SOLIMP
    return spec.compile()


def _add(spec: Any, solid: Solid) -> list[Any]:
    body = spec.worldbody.add_body(name=solid.name, pos=solid.at)
    body.add_freejoint()
    body.explicitinertial, body.mass, body.ipos = True, solid.mass, solid.centre
    body.inertia = solid.moments
    if solid.shape == "sphere":
        size = (solid.size[0], 0.0, 0.0)
        return [body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=size)]
    if solid.shape == "box":
        half = [0.5 * length for length in solid.size]
        return [body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=half)]
    up, size = np.array((0.0, 0.0, _FOOT)), (_FOOT, 0.0, 0.0)
    sphere = mujoco.mjtGeom.mjGEOM_SPHERE
    return [body.add_geom(type=sphere, size=size, pos=corner + up) for corner in solid.feet]


def _forces(problem: Problem, model: Any, data: Any) -> Array:
    """Normal forces at the end [N], as `Trace` orders them."""
    mujoco.mj_forward(model, data)
    is_split = problem.solids[0].shape == "feet"
    forces, force = np.zeros(4 if is_split else len(problem.pairs)), np.zeros(6)
    for i in range(data.ncon):
        mujoco.mj_contactForce(model, data, i, force)
        bodies = sorted(int(model.geom_bodyid[g]) for g in data.contact[i].geom)
        feet = model.body_geomadr[1]
        foot = int(max(data.contact[i].geom)) - int(feet)
        forces[foot if is_split else bodies[1] - 1] += force[0]
    return forces
