"""OpenSim's part of `tracking.py`: CPU time and cost of MocoTrack; prints JSON.

MODEL.osim MOTION.mot EXTERNAL.xml FIRST LAST INTERVAL WEIGHT EFFORT [GUESS.csv]

With a motion as guess, columns as `mbd-ros predict` writes them, it begins there.
"""

import csv
import json
import sys
import time

import numpy as np
import opensim

_STRONGEST = 1.0e30  # no bound of a drive


def main() -> int:
    """Solve once."""
    model, motion, external, *numbers = sys.argv[1:9]
    first, last, interval, weight, effort = map(float, numbers)
    begin = time.process_time()
    driven = opensim.ModelProcessor(model)
    driven.append(opensim.ModOpRemoveMuscles())
    driven.append(opensim.ModOpAddExternalLoads(external))
    driven.append(opensim.ModOpAddReserves(1.0, _STRONGEST, True))
    recorded = opensim.TableProcessor(motion)
    recorded.append(opensim.TabOpUseAbsoluteStateNames())
    track = opensim.MocoTrack()
    track.setModel(driven)
    track.setStatesReference(recorded)
    track.set_states_global_tracking_weight(weight)
    track.set_allow_unused_references(True)
    track.set_initial_time(first)
    track.set_final_time(last)
    track.set_mesh_interval(interval)
    track.set_control_effort_weight(effort)
    study = track.initialize()
    solver = opensim.MocoCasADiSolver.safeDownCast(study.updSolver())
    solver.resetProblem(study.updProblem())
    solver.set_parallel(0)
    if len(sys.argv) > 9:
        solver.setGuess(_guess(solver, sys.argv[9]))
    solved = study.solve()
    found = {"seconds": time.process_time() - begin, "cost": solved.getObjective()}
    print(json.dumps(found | {"good": solved.success(), "iterations": solved.getNumIterations()}))
    return 0


def _guess(solver: opensim.MocoCasADiSolver, file: str) -> opensim.MocoTrajectory:
    """States and controls of a motion at the times of a guess."""
    with open(file, encoding="utf-8") as lines:
        rows = [row for row in csv.reader(lines) if row and not row[0].startswith("#")]
    names, values = rows[0], np.array(rows[1:], dtype=float).T
    columns = dict(zip(names, values, strict=True))
    guess = solver.createGuess()
    times = [guess.getTime()[i] for i in range(guess.getNumTimes())]

    def vector(name: str) -> opensim.Vector:
        found = opensim.Vector(len(times), 0.0)
        for i, value in enumerate(np.interp(times, columns["time"], columns[name])):
            found[i] = float(value)
        return found

    for name in guess.getStateNames():
        *_, joint, kind = name.split("/")
        quantity = "position" if kind == "value" else "velocity"
        guess.setState(name, vector(f"{joint}.{quantity}"))
    efforts = [name.removesuffix(".effort") for name in columns if name.endswith(".effort")]
    for name in guess.getControlNames():
        (joint,) = [one for one in efforts if name.endswith(f"_{one}")]
        guess.setControl(name, vector(f"{joint}.effort"))
    return guess


if __name__ == "__main__":
    sys.exit(main())
