"""Motions with known torques, for identification."""

import numpy as np
import pinocchio as pin

from mbd_ros.files.table import Column, Result, Table


def fourier(joints, t, seed, frequency=0.2, amplitude=0.5):
    """Position, velocity and acceleration of five harmonics a joint."""
    random, w = np.random.default_rng(seed), 2.0 * np.pi * frequency
    q, v, a = np.zeros((3, len(t), joints))
    for k in range(1, 6):
        A, B = random.normal(0.0, amplitude, (2, joints)) / k
        s, c = np.sin(w * k * t)[:, None], np.cos(w * k * t)[:, None]
        q += A * s + B * c
        v += w * k * (A * c - B * s)
        a -= (w * k) ** 2 * (A * s + B * c)
    return q, v, a


def others(scene, seed=3, shift=0.01):
    """The scene with other masses, mass centres and moments."""
    random = np.random.default_rng(seed)
    changed = {}
    for link, given in scene.robot.inertias().items():
        if given.mass > 0.0:
            mass, moments = given.mass * random.uniform(0.7, 1.3), random.uniform(0.9, 1.3)
            centre = given.lever + random.normal(0.0, shift, 3)
            changed[link] = pin.Inertia(mass, centre, given.inertia * moments)
    return scene.with_inertias(changed)


def recording(names, t, **fields):
    """A result with columns `<joint>.<field>`, each field of shape (n, joints)."""
    columns = [Column("time", t)]
    for field, values in fields.items():
        columns += [
            Column(f"{n}.{field}", values[:, i])
            for i, n in enumerate(names)
            if i < values.shape[1]
        ]
    return Result({"samples": Table(columns)})


def flown(scene, true, t, seed=1):
    """Recordings of a floating robot: all but efforts, and the wrench that carries its base.

    Velocities are prescribed; poses follow by steps that need not be exact, since dynamics holds
    for any pose.
    """
    model, (base,) = true.robot.model, true.robot.bases
    _, v, a = fourier(model.nv, t, seed, amplitude=0.4)
    q = [true.robot.neutral()]
    for before, after, step in zip(v, v[1:], np.diff(t), strict=False):
        q.append(pin.integrate(model, q[-1], 0.5 * step * (before + after)))
    q, data = np.array(q), model.createData()
    tau = np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)])
    pose = [f"position.{x}" for x in "xyz"] + [f"orientation.{x}" for x in "xyzw"]
    columns = [Column("time", t)]
    columns += [Column(f"{base.name}.{n}", q[:, base.q][:, k]) for k, n in enumerate(pose)]
    for word, values in (("velocity", v), ("acceleration", a)):
        names = [f"{kind}_{word}.{x}" for kind in ("linear", "angular") for x in "xyz"]
        own = values[:, base.v]
        columns += [Column(f"{base.name}.{n}", own[:, k]) for k, n in enumerate(names)]
    for joint in scene.robot.joints:
        at = {"position": q[:, joint.q], "velocity": v[:, joint.v], "acceleration": a[:, joint.v]}
        columns += [Column(f"{joint.name}.{field}", values) for field, values in at.items()]
    pushes = [f"push.{kind}.{x}" for kind in ("force", "torque") for x in "xyz"]
    pushed = [Column(name, tau[:, base.v][:, k]) for k, name in enumerate(pushes)]
    loads = Table([Column("time", t), *pushed])
    return Result({"samples": Table(columns)}), Result({"samples": loads})


def moved(scene, true, t, seed=1, noise=0.0, **options):
    """A recording of a true scene on a random motion, with accelerations."""
    names = scene.couplings.independent
    q, v, a = fourier(len(names), t, seed, **options)
    tau = true.inverse_dynamics().batch(q, v, a, []).tau
    tau = tau + noise * np.random.default_rng(seed).normal(size=tau.shape)
    return recording(names, t, position=q, velocity=v, acceleration=a, effort=tau)
