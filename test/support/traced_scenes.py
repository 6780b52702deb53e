"""Cases that several tests share: traced scenes."""

import numpy as np
import pinocchio as pin
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.core.state import State
from mbd_ros.errors import SolveError
from mbd_ros.methods.projection.assembly import assemble

SCENES = ROOT / "config/scenes"


EXACT = 1e-12


def scene_of(name):
    return load_scene(SCENES / f"{name}.yaml")


def states(system, count=4, patience=100):
    """Consistent states, and inputs beside the safe ones; as many as that many tries find."""
    rng, found = np.random.default_rng(3), []
    neutral = pin.neutral(system.chart.model)
    for _ in range(patience):
        if len(found) == count:
            break
        q = pin.integrate(system.chart.model, neutral, rng.uniform(-0.5, 0.5, system.nv))
        z = within(system.internals, rng)
        u = system.loads.idle + rng.normal(size=len(system.loads.idle))
        try:
            y = assemble(system, State(0.3, q, rng.normal(size=system.nv), z))
        except SolveError:
            continue
        found.append((y, u))
    return found


def within(internals, rng):
    """Internal states inside their bounds, not at them: there are kinks."""
    z = internals.inside(rng.normal(size=internals.nz))
    room = np.minimum(internals.upper - internals.lower, 1.0)
    at_end = (z == internals.lower) | (z == internals.upper)
    return np.where(at_end, internals.lower + room * rng.uniform(0.1, 0.4, len(z)), z)


def conditions(system, y):
    """Condition of M, and of J M^-1 J' in the metric of both."""
    M = np.array(system.mass(y.q).dense)
    if not system.bilateral.rows:
        return np.linalg.cond(M)
    J = system.bilateral.jacobian(y.t, y.q)
    return max(np.linalg.cond(M), np.linalg.cond(J @ np.linalg.solve(M, J.T)))


def called(function, y, u):
    found = function.call([y.t, y.q, y.v, y.z, u, np.zeros(0)])
    return [np.array(one).ravel() for one in found]


def tangent(model, q):
    """Rates of a configuration by steps in its tangent, by differences: they are linear."""
    step = 1e-6
    moved = [pin.integrate(model, q, step * one) for one in np.eye(model.nv)]
    back = [pin.integrate(model, q, -step * one) for one in np.eye(model.nv)]
    return (np.array(moved) - np.array(back)).T / (2.0 * step)
