"""Optimal control problems in OpenSim Moco, timed: run by the Python that has the wheel `opensim`.

python moco_problems.py PROBLEM INTERVALS [free]

Prints JSON: cost and CPU seconds of building and solving, one thread. `free` lets controls at the
middle of intervals free, which Moco binds to straight lines by default. Exit code 1 where Moco
finds nothing.
"""

import contextlib
import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator

import opensim as osim

HANGING = {  # tendon: activations at both ends
    "rigid": (0.1453722025540807, 0.1643111234478267),
    "elastic": (0.147867218987404, 0.1682727008662497),
}


def main() -> int:
    """Solve one problem."""
    name, intervals, is_free = sys.argv[1], int(sys.argv[2]), "free" in sys.argv
    osim.Logger.setLevelString("off")
    with quiet():
        begin = time.process_time()
        study, states = PROBLEMS[name]()
        solver = osim.MocoCasADiSolver.safeDownCast(study.updSolver())
        solver.set_num_mesh_intervals(intervals)
        solver.set_parallel(0)
        solver.set_interpolate_control_mesh_interior_points(not is_free)
        solver.setGuess(lines(solver, states))
        found = study.solve()
        seconds = time.process_time() - begin
    json.dump({"cost": found.getObjective(), "seconds": seconds}, sys.stdout)
    return 0 if found.success() else 1


def lines(solver: osim.MocoCasADiSolver, states: dict) -> osim.MocoTrajectory:
    """Straight lines between the ends for states; controls 0 where they may be, else low."""
    guess = solver.createGuess("bounds")
    n = guess.getNumTimes()
    for name, (_, first, last) in states.items():
        values = [first + (last - first) * i / (n - 1) for i in range(n)]
        guess.setState(name, osim.Vector(values))
    for control in guess.getControlNames():
        guess.setControl(control, osim.Vector(n, 0.1 if "muscle" in control else 0.0))
    return guess


def cart_pole() -> tuple[osim.MocoStudy, dict]:
    """Swing-up of M. Kelly, SIAM Review 59, 2017, sec. 6."""
    model = osim.Model()
    model.set_gravity(osim.Vec3(0, -9.81, 0))
    cart = osim.Body("cart", 1.0, osim.Vec3(0), osim.Inertia(0, 0, 0))
    pole = osim.Body("pole", 0.3, osim.Vec3(0, -0.5, 0), osim.Inertia(0))
    slide = osim.SliderJoint("slide", model.getGround(), cart)
    swing = osim.PinJoint("swing", cart, pole)
    slide.updCoordinate().setName("x")
    swing.updCoordinate().setName("q")
    for part in (cart, pole):
        model.addBody(part)
    for part in (slide, swing):
        model.addJoint(part)
    drive(model, slide.updCoordinate(), "push")
    states = {
        "/jointset/slide/x/value": ([-2.0, 2.0], 0.0, 1.0),
        "/jointset/slide/x/speed": ([-50.0, 50.0], 0.0, 0.0),
        "/jointset/swing/q/value": ([-10.0, 10.0], 0.0, math.pi),
        "/jointset/swing/q/speed": ([-50.0, 50.0], 0.0, 0.0),
    }
    return effort(model, 2.0, states, {"/forceset/push": [-20.0, 20.0]})


def double_pendulum() -> tuple[osim.MocoStudy, dict]:
    """Swing-up of Moco's own model in 1.5 s."""
    states = {
        "/jointset/j0/q0/value": ([-10.0, 10.0], -math.pi / 2, math.pi / 2),
        "/jointset/j0/q0/speed": ([-50.0, 50.0], 0.0, 0.0),
        "/jointset/j1/q1/value": ([-10.0, 10.0], 0.0, 0.0),
        "/jointset/j1/q1/speed": ([-50.0, 50.0], 0.0, 0.0),
    }
    controls = {"/tau0": [-100.0, 100.0], "/tau1": [-100.0, 100.0]}
    return effort(osim.ModelFactory.createDoublePendulum(), 1.5, states, controls)


def hanging(tendon: str) -> tuple[osim.MocoStudy, dict]:
    """A mass of 0.5 kg lifted by one muscle in 0.5 s, minimum excitation squared."""
    model = osim.Model()
    model.set_gravity(osim.Vec3(9.81, 0, 0))
    body = osim.Body("body", 0.5, osim.Vec3(0), osim.Inertia(0))
    joint = osim.SliderJoint("joint", model.getGround(), body)
    joint.updCoordinate().setName("height")
    model.addBody(body)
    model.addJoint(joint)
    muscle = osim.DeGrooteFregly2016Muscle()
    muscle.setName("muscle")
    muscle.set_max_isometric_force(30.0)
    muscle.set_optimal_fiber_length(0.1)
    muscle.set_tendon_slack_length(0.05)
    muscle.set_tendon_strain_at_one_norm_force(0.1)
    muscle.set_pennation_angle_at_optimal(0.1)
    muscle.set_ignore_tendon_compliance(tendon == "rigid")
    muscle.set_fiber_damping(0.01)
    muscle.set_max_contraction_velocity(10.0)
    muscle.set_tendon_compliance_dynamics_mode("implicit")
    muscle.addNewPathPoint("origin", model.updGround(), osim.Vec3(0))
    muscle.addNewPathPoint("insertion", body, osim.Vec3(0))
    model.addForce(muscle)
    first, last = HANGING[tendon]
    states = {
        "/joint/height/value": ([0.05, 0.3], 0.15, 0.14),
        "/joint/height/speed": ([-10.0, 10.0], 0.0, 0.0),
        "/forceset/muscle/activation": ([0.01, 1.0], first, last),
    }
    if tendon == "elastic":
        states["/forceset/muscle/normalized_tendon_force"] = ([0.0, 5.0], 0.1635, 0.1635)
    states = {name.replace("/joint/", "/jointset/joint/"): s for name, s in states.items()}
    return effort(model, 0.5, states, {"/forceset/muscle": [0.01, 1.0]})


def drive(model: osim.Model, coordinate: osim.Coordinate, name: str) -> None:
    """A torque or force of a coordinate."""
    actuator = osim.CoordinateActuator()
    actuator.setCoordinate(coordinate)
    actuator.setName(name)
    actuator.setOptimalForce(1.0)
    actuator.setMinControl(-math.inf)
    actuator.setMaxControl(math.inf)
    model.addForce(actuator)


def effort(
    model: osim.Model, duration: float, states: dict, controls: dict
) -> tuple[osim.MocoStudy, dict]:
    """Minimum squared controls between two states."""
    study = osim.MocoStudy()
    problem = study.updProblem()
    model.finalizeConnections()
    problem.setModel(model)
    problem.setTimeBounds(0.0, duration)
    for name, (bounds, first, last) in states.items():
        problem.setStateInfo(name, bounds, first, last)
    for name, bounds in controls.items():
        problem.setControlInfo(name, bounds)
    problem.addGoal(osim.MocoControlGoal("effort"))
    study.initCasADiSolver()
    return study, states


PROBLEMS: dict[str, Callable[[], tuple[osim.MocoStudy, dict]]] = {
    "cart_pole": cart_pole,
    "double_pendulum": double_pendulum,
    "hanging_rigid": lambda: hanging("rigid"),
    "hanging_elastic": lambda: hanging("elastic"),
}


@contextlib.contextmanager
def quiet() -> Iterator[None]:
    """Nothing on stdout: the solver prints from C."""
    kept, nowhere = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.close(kept)
        os.close(nowhere)


if __name__ == "__main__":
    sys.exit(main())
