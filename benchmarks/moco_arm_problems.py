"""Reaches of two arms in OpenSim Moco, timed: run by the Python that has the wheel `opensim`.

python moco_arm_problems.py arm7.urdf|arm26.osim INTERVALS < PROBLEM.json

Prints JSON: cost and CPU seconds of building and solving, one thread, and for a URDF the torques
of inverse dynamics at the states of the problem. Exit code 1 where Moco finds nothing.
"""

import json
import math
import sys
import time
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import opensim as osim
from moco_problems import drive, lines, quiet

TILTS = {"0 0 1": 0.0, "0 1 0": -math.pi / 2, "0 -1 0": math.pi / 2}  # about x: z to the axis
TOLERANCE = 1.0e-3  # of IPOPT's conditions, in which Moco's costs are within its mesh errors
LEAST = 0.01  # activation
ARM26 = {"r_shoulder_elev": "r_shoulder", "r_elbow_flex": "r_elbow"}
RANGES = {"r_shoulder_elev": [-0.5, 1.0], "r_elbow_flex": [-0.2, 2.0]}
FASTEST = 50.0  # rad/s


def main() -> int:
    """Solve one problem."""
    osim.Logger.setLevelString("off")
    model, intervals, given = Path(sys.argv[1]), int(sys.argv[2]), json.load(sys.stdin)
    torques = inverse(arm7(model)[0], given["poses"]) if "poses" in given else []
    with quiet():
        begin = time.process_time()
        study, states = (reach_of_arm7 if model.suffix == ".urdf" else reach_of_arm26)(
            model, given
        )
        solver = osim.MocoCasADiSolver.safeDownCast(study.updSolver())
        solver.set_num_mesh_intervals(intervals)
        solver.set_parallel(0)
        solver.set_interpolate_control_mesh_interior_points(False)
        solver.set_optim_convergence_tolerance(TOLERANCE)
        solver.set_optim_constraint_tolerance(TOLERANCE)
        guess = lines(solver, states)
        for control in guess.getControlNames() if model.suffix == ".osim" else ():
            guess.setControl(control, osim.Vector(guess.getNumTimes(), given["activation"]))
        solver.setGuess(guess)
        found = study.solve()
        seconds = time.process_time() - begin
    found.unseal() if found.isSealed() else None
    out = {"cost": found.getObjective(), "seconds": seconds, "torques": torques}
    json.dump(out | {"found": found.success()}, sys.stdout)
    return 0 if found.success() else 1


def arm7(urdf: Path) -> tuple[osim.Model, dict[str, dict[str, float]]]:
    """The model of a URDF with revolute joints about z or y, and limits of its joints."""
    model, tree, limits = osim.Model(), ET.parse(urdf).getroot(), {}
    model.set_gravity(osim.Vec3(0, 0, -9.81))
    bodies = {"base": model.getGround()}
    for link in tree.findall("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            name, moments = link.get("name"), inertial.find("inertia")
            entries = [
                float(moments.get(f"i{key}")) for key in ("xx", "yy", "zz", "xy", "xz", "yz")
            ]
            mass = float(inertial.find("mass").get("value"))
            bodies[name] = osim.Body(name, mass, vector(inertial), osim.Inertia(*entries))
            model.addBody(bodies[name])
    for joint in tree.findall("joint"):
        if joint.get("type") == "fixed":
            continue
        name, turn = joint.get("name"), osim.Vec3(TILTS[joint.find("axis").get("xyz")], 0, 0)
        parent, child = (bodies[joint.find(key).get("link")] for key in ("parent", "child"))
        made = osim.PinJoint(name, parent, vector(joint), turn, child, osim.Vec3(0), turn)
        made.updCoordinate().setName(f"q_{name}")
        model.addJoint(made)
        drive(model, made.updCoordinate(), f"torque_{name}")
        limits[name] = {key: float(value) for key, value in joint.find("limit").items()}
    model.finalizeConnections()
    return model, limits


def vector(element: ET.Element) -> osim.Vec3:
    """The place that an element says."""
    return osim.Vec3(*map(float, element.find("origin").get("xyz").split()))


def inverse(model: osim.Model, poses: list[list[list[float]]]) -> list[list[float]]:
    """Torques of inverse dynamics at positions, velocities and accelerations."""
    state, found = model.initSystem(), []
    solver, count = osim.InverseDynamicsSolver(model), model.getNumCoordinates()
    for q, v, a in poses:
        for i in range(count):
            coordinate = model.getCoordinateSet().get(i)
            coordinate.setValue(state, q[i], False)
            coordinate.setSpeedValue(state, v[i])
        model.realizeDynamics(state)
        torques = solver.solve(state, osim.Vector(a))
        found.append([torques.get(i) for i in range(count)])
    return found


def reach_of_arm7(urdf: Path, given: dict[str, Any]) -> tuple[osim.MocoStudy, dict]:
    """From standing straight to some positions, rest to rest; minimum torque squared."""
    model, limits = arm7(urdf)
    states, controls = {}, {}
    for name, one in limits.items():
        place = f"/jointset/{name}/q_{name}"
        states[f"{place}/value"] = ([one["lower"], one["upper"]], 0.0, given["end"][name])
        states[f"{place}/speed"] = ([-one["velocity"], one["velocity"]], 0.0, 0.0)
        controls[f"/forceset/torque_{name}"] = [-one["effort"], one["effort"]]
    return study_of(osim.ModelProcessor(model), given["duration"], states, controls, {})


def reach_of_arm26(osim_file: Path, given: dict[str, Any]) -> tuple[osim.MocoStudy, dict]:
    """A reach by muscles with elastic tendons; minimum excitation squared."""
    model = osim.ModelProcessor(osim.Model(str(osim_file)))
    model.append(osim.ModOpReplaceMusclesWithDeGrooteFregly2016())
    model.append(osim.ModOpUseImplicitTendonComplianceDynamicsDGF())
    states, controls, first = {}, {}, {}
    for name, joint in ARM26.items():
        place, ends = f"/jointset/{joint}/{name}", (given["start"][name], given["end"][name])
        states[f"{place}/value"] = (RANGES[name], *ends)
        states[f"{place}/speed"] = ([-FASTEST, FASTEST], 0.0, 0.0)
    for muscle, tension in given["tensions"].items():
        place, activation = f"/forceset/{muscle}", given["activation"]
        first[f"{place}/activation"] = ([LEAST, 1.0], activation)
        first[f"{place}/normalized_tendon_force"] = ([0.0, 1.8], tension)
        controls[place] = [LEAST, 1.0]
    return study_of(model, given["duration"], states, controls, first)


def study_of(
    model: osim.ModelProcessor, duration: float, states: dict, controls: dict, first: dict
) -> tuple[osim.MocoStudy, dict]:
    """Minimum squared controls; `first` has states that are given at the beginning alone."""
    study = osim.MocoStudy()
    problem = study.updProblem()
    problem.setModelProcessor(model)
    problem.setTimeBounds(0.0, duration)
    for name, bounds in controls.items():
        problem.setControlInfo(name, bounds)
    for name, (bounds, *ends) in (states | first).items():
        problem.setStateInfo(name, bounds, *ends)
    problem.addGoal(osim.MocoControlGoal("effort"))
    study.initCasADiSolver()
    return study, states | {name: (bounds, one, one) for name, (bounds, one) in first.items()}


if __name__ == "__main__":
    sys.exit(main())
