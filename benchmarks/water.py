"""Rigid waters without interaction beside OpenMM, CPU time a step of one thread.

    python benchmarks/water.py [MOLECULES]

OpenMM takes leapfrog steps (its `VerletIntegrator`, CPU platform, constraints on); ours are those
of RATTLE, which move velocities onto the rows, too. Same masses, lengths and step; times are the
least of several runs that take turns. Prints JSON with ratios to OpenMM.
"""

import json
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import openmm

import mbd_ros as mbd

MOLECULES, STEPS, ROUNDS, DT = 10_000, 100, 7, 2.0e-3  # ps
MASSES, SIDE, ANGLE, APART = (15.9994, 1.008, 1.008), 1.0, np.deg2rad(109.47), 5.0  # amu, angstrom
KELVIN = 300.0


def main() -> None:
    """Time both tiers and OpenMM in turns; print."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else MOLECULES
    runs = {"openmm": peer(count)}
    runs |= {kind: ours(count, kind) for kind in ("plain", "compiled")}
    seconds = {name: float("inf") for name in runs}
    for _ in range(ROUNDS):
        for name, run in runs.items():
            begin = time.process_time()
            run()
            seconds[name] = min(seconds[name], (time.process_time() - begin) / STEPS)
    found: dict[str, Any] = {"molecules": count, "seconds a step": seconds}
    found["ratio"] = {n: s / seconds["openmm"] for n, s in seconds.items() if n != "openmm"}
    found["load"] = os.getloadavg()
    json.dump(found, sys.stdout, indent=2)
    print()


def places(count: int) -> np.ndarray:
    """Centres of the molecules on a cubic lattice [angstrom]."""
    edge = int(np.ceil(count ** (1.0 / 3.0)))
    return APART * np.array(list(np.ndindex(edge, edge, edge)))[:count]


def corners() -> np.ndarray:
    """One molecule [angstrom]."""
    across, along = SIDE * np.sin(0.5 * ANGLE), SIDE * np.cos(0.5 * ANGLE)
    return np.array([[0.0, 0.0, 0.0], [along, across, 0.0], [along, -across, 0.0]])


def ours(count: int, solver: str) -> Callable[[], None]:
    """Steps of a scene."""
    names = ("O", "H1", "H2")
    atoms = {n: {"mass": m, "at": p} for n, m, p in zip(names, MASSES, corners(), strict=True)}
    bonds = [{"between": [names[i], names[j]]} for i, j in ((0, 1), (0, 2), (1, 2))]
    placement = {"positions": places(count)}
    water = {"atoms": atoms, "bonds": bonds, "count": count, "placement": placement}
    scene = mbd.scene_from(
        {
            "units": "molecular",
            "particles": {"molecules": {"water": water}},
            "initial": {"temperature": KELVIN},
            "solver": {"type": solver},
            "dt": DT,
        }
    )
    stepper, states = scene.stepper(), [scene.initial]

    def run() -> None:
        states[0] = stepper.advance(states[0], states[0].t + STEPS * DT)

    run()
    return run


def peer(count: int) -> Callable[[], None]:
    """Steps of OpenMM."""
    system = openmm.System()
    sides = ((0, 1, SIDE), (0, 2, SIDE), (1, 2, 2.0 * SIDE * np.sin(0.5 * ANGLE)))
    for molecule in range(count):
        for mass in MASSES:
            system.addParticle(mass)
        for i, j, length in sides:
            system.addConstraint(3 * molecule + i, 3 * molecule + j, 0.1 * length)  # nm
    integrator = openmm.VerletIntegrator(DT)
    platform = openmm.Platform.getPlatformByName("CPU")
    context = openmm.Context(system, integrator, platform, {"Threads": "1"})
    context.setPositions(0.1 * (places(count)[:, None] + corners()).reshape(-1, 3))
    context.setVelocitiesToTemperature(KELVIN, 1)

    def run() -> None:
        integrator.step(STEPS)
        context.getState(positions=True)

    run()
    return run


if __name__ == "__main__":
    main()
