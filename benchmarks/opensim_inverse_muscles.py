"""OpenSim's part of `muscle_inverse.py`: CPU time of MocoInverse; prints JSON.

MODEL.osim MOTION.mot EXTERNAL.xml CUTOFF INTERVAL RESERVES activation|tendon
"""

import json
import sys
import time

import opensim


def main() -> int:
    """Solve once."""
    model, motion, external, cutoff, interval, reserves, dynamics = sys.argv[1:]
    begin = time.process_time()
    muscled = opensim.ModelProcessor(model)
    muscled.append(opensim.ModOpAddExternalLoads(external))
    if dynamics == "activation":
        muscled.append(opensim.ModOpIgnoreTendonCompliance())
    muscled.append(opensim.ModOpReplaceMusclesWithDeGrooteFregly2016())
    if dynamics == "tendon":
        muscled.append(opensim.ModOpTendonComplianceDynamicsModeDGF("implicit"))
    muscled.append(opensim.ModOpAddReserves(float(reserves)))
    recorded = opensim.TableProcessor(motion)
    recorded.append(opensim.TabOpLowPassFilter(float(cutoff)))
    recorded.append(opensim.TabOpUseAbsoluteStateNames())
    table = opensim.TimeSeriesTable(motion)
    inverse = opensim.MocoInverse()
    inverse.setModel(muscled)
    inverse.setKinematics(recorded)
    times = table.getIndependentColumn()
    inverse.set_initial_time(times[0])
    inverse.set_final_time(times[-1] - 1.0e-3)  # its filter takes some of the end
    inverse.set_mesh_interval(float(interval))
    inverse.set_kinematics_allow_extra_columns(True)
    solved = inverse.solve().getMocoSolution()
    print(json.dumps({"seconds": time.process_time() - begin, "good": solved.success()}))
    return 0


if __name__ == "__main__":
    sys.exit(main())
