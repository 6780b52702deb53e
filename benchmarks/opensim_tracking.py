"""OpenSim's part of `tracking.py`: CPU time and cost of MocoTrack; prints JSON.

MODEL.osim MOTION.mot EXTERNAL.xml FIRST LAST INTERVAL WEIGHT EFFORT
"""

import json
import sys
import time

import opensim

_STRONGEST = 1.0e30  # no bound of a drive


def main() -> int:
    """Solve once."""
    model, motion, external, *numbers = sys.argv[1:]
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
    solved = study.solve()
    found = {"seconds": time.process_time() - begin, "cost": solved.getObjective()}
    print(json.dumps(found | {"good": solved.success(), "iterations": solved.getNumIterations()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
