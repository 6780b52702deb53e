"""Cases that several tests share: state projection."""

from dataclasses import replace

import numpy as np
import qpsolvers
from places import ROOT

from mbd_ros.api import load_scene
from mbd_ros.core.dynamics.tiers import build_system
from mbd_ros.core.loads.loads import Loads
from mbd_ros.core.rows.constraint_rows import rigid
from mbd_ros.core.state import State
from mbd_ros.methods.projection.state_projection import Measurement, StateProjector

SCENES = ROOT / "config/scenes"


LEG, FOUR_BAR, ARM = "prosthetic_leg", "four_bar_leg", "prosthetic_arm"


def projector(name, ends=None, **options):
    """A scene of the package and its projector; `ends` replace the limits of the joints."""
    scene = load_scene(SCENES / f"{name}.yaml")
    if ends is not None:
        joints = [
            replace(joint, lower=ends[0][joint.v], upper=ends[1][joint.v])
            for joint in scene.robot.joints
        ]
        scene = replace(scene, robot=replace(scene.robot, joints=tuple(joints)))
    rows, loads = rigid(scene.constraints), Loads(scene.robot.model.nv)
    system = build_system(scene.robot, scene.couplings, rows, loads, "kkt")
    return scene, StateProjector(system, **options)


def measured(q, v=None, missing=(), scene=None, missing_velocity=None):
    """A measurement at t = 0 that lacks the joints named in `missing`."""
    v = np.zeros(len(q)) if v is None else v
    known, known_velocity = np.ones(len(q), dtype=bool), np.ones(len(q), dtype=bool)
    for name in missing:
        known[scene.robot.joint(name).v] = False
    for name in missing if missing_velocity is None else missing_velocity:
        known_velocity[scene.robot.joint(name).v] = False
    return Measurement(State(0.0, q, v), known, known_velocity)


def nearest_in_z(scene, system, m, lower, upper):
    """Oracle 1: dependent joints eliminated, q = F(z), by quadprog; no multipliers, no rows."""
    M, couplings = system.mass(m.x.q).dense, scene.couplings
    z = m.x.q[couplings.q_index].copy()
    W = np.where(m.known[:, None] & m.known, M, 0.0)
    for _ in range(200):
        q = couplings.positions(z)
        G = couplings.jacobian(q)
        p = q - m.x.q
        bounds = np.vstack([G, -G]), np.r_[upper - q, q - lower]
        dz = qpsolvers.solve_qp(G.T @ W @ G, G.T @ W @ p, *bounds, solver="quadprog")
        z = z + dz
        if np.abs(dz).max() < 1e-13:
            break
    q = couplings.positions(z)
    G = couplings.jacobian(q)
    W_v = np.where(m.known_velocity[:, None] & m.known_velocity, M, 0.0)
    low, high = q < lower + 1e-9, q > upper - 1e-9
    stop = np.vstack([-G[low], G[high]])
    rows = (stop, np.zeros(len(stop))) if len(stop) else (None, None)
    w = qpsolvers.solve_qp(G.T @ W_v @ G, -G.T @ W_v @ m.x.v, *rows, solver="quadprog")
    return q, G @ w
