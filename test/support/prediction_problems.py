"""Optimal motions whose costs are known, as scenes of this package and tasks.

Costs and multipliers were found twice by others: by Pontryagin's boundary value problem (multiple
shooting, relative tolerance 3e-14) and by Gauss collocation; no rigid-body library was used.
"""

import math

import mbd_ros as mbd


def link(name, m=0.0, com="0 0 0", inertia=0.0):
    moments = " ".join(f"i{axis}='{inertia}'" for axis in ("xx", "yy", "zz"))
    inertial = (
        f"<origin xyz='{com}'/><mass value='{m}'/><inertia {moments} ixy='0' ixz='0' iyz='0'/>"
    )
    return f"<link name='{name}'>" + (f"<inertial>{inertial}</inertial>" if m else "") + "</link>"


def joint(name, kind, parent, child, axis, origin="0 0 0"):
    return (
        f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>"
        f"<origin xyz='{origin}'/><axis xyz='{axis}'/>"
        "<limit lower='-100' upper='100' effort='1e6' velocity='1000'/></joint>"
    )


def urdf(*parts):
    return f"<robot name='r'><link name='ground'/>{''.join(parts)}</robot>"


def drives(*joints):
    return [{"type": "ideal", "joints": list(joints)}]


def double_pendulum():
    """Links of 1 m with 1 kg and 1 kg m² at their ends; angles from the x axis, y up."""
    return urdf(
        link("upper", 1.0, "1 0 0", 1.0),
        link("lower", 1.0, "1 0 0", 1.0),
        joint("q0", "continuous", "ground", "upper", "0 0 1"),
        joint("q1", "continuous", "upper", "lower", "0 0 1", "1 0 0"),
    )


DOWN = {"gravity": [0.0, -9.80665, 0.0]}


def swing_up():
    """Both links from hanging to standing, by two torques; minimum torque squared."""
    scene = mbd.scene_from(
        {
            "robot": DOWN,
            "actuators": drives("q0", "q1"),
            "initial": {"position": {"q0": -math.pi / 2}},
        },
        urdf=double_pendulum(),
    )
    task = {
        "duration": 1.5,
        "end": {"q0.position": math.pi / 2, "q1.position": 0.0, "*.velocity": 0.0},
        "goals": [{"type": "effort"}],
        "guess": {"q0.position": [-math.pi / 2, math.pi / 2], "q0.velocity": [0.0, 0.0]},
    }
    return scene, task, 929.7542742458


def coupled_arm(driven=("q0", "q1"), cost=371.50283295457):
    """The end point moves on the y axis, since q1 = pi - 2 q0."""
    scene = mbd.scene_from(
        {
            "robot": DOWN,
            "actuators": drives(*driven),
            "couplings": {"q1": {"parent": "q0", "factor": -2.0, "offset": math.pi}},
            "initial": {"position": {"q0": 0.0}},
        },
        urdf=double_pendulum(),
    )
    task = {
        "duration": 1.0,
        "end": {"q0.position": math.pi / 2, "q0.velocity": 0.0},
        "goals": [{"type": "effort"}],
    }
    return scene, task, cost


def rod(name, length, mass):
    return link(name, mass, f"{length / 2} 0 0", mass * length**2 / 12)


def four_bar():
    """One turn of the crank of a four-bar, rest to rest; the loop is cut at C."""
    robot = urdf(
        rod("AB", 0.1, 0.5),
        rod("BC", 0.4, 2.0),
        rod("DC", 0.3, 1.5),
        joint("crank", "continuous", "ground", "AB", "0 0 1"),
        joint("coupler", "continuous", "AB", "BC", "0 0 1", "0.1 0 0"),
        joint("rocker", "continuous", "ground", "DC", "0 0 1", "0.4 0 0"),
    )
    c = (0.3666666666666667, 0.29814239699997197)
    place = {
        "crank": 0.0,
        "coupler": math.atan2(c[1], c[0] - 0.1),
        "rocker": math.atan2(c[1], c[0] - 0.4),
    }
    loop = {"type": "loop_closure", "name": "C", "frame_a": "BC", "frame_b": "DC"}
    loop |= {"point_a": [0.4, 0.0, 0.0], "point_b": [0.3, 0.0, 0.0]}
    loop |= {"kind": "point", "directions": "xy"}
    scene = mbd.scene_from(
        {
            "robot": {"gravity": [0.0, -9.81, 0.0]},
            "actuators": drives("crank"),
            "constraints": [loop],
            "initial": {"position": place},
        },
        urdf=robot,
    )
    task = {
        "duration": 1.0,
        "end": {"crank.position": 2.0 * math.pi, "crank.velocity": 0.0},
        "goals": [{"type": "effort"}],
        "guess": {"crank.position": [0.0, 2.0 * math.pi]},
    }
    return scene, task, 0.5968733288904


MUSCLE = {
    "type": "degroote_fregly",
    "name": "muscle",
    "path": {"points": [{"frame": "world"}, {"frame": "body"}]},
    "max_isometric_force": 30.0,
    "optimal_fiber_length": 0.1,
    "tendon_slack_length": 0.05,
    "pennation_angle": 0.1,
    "tendon_strain": 0.1,
}


def hanging_muscle(tendon="rigid"):
    """A mass of 0.5 kg that one muscle lifts by 1 cm; minimum excitation squared."""
    robot = urdf(link("body", 0.5), joint("x", "prismatic", "ground", "body", "1 0 0"))
    ends = {
        "rigid": (0.1453722025540807, 0.1643111234478267, 0.01272601618034),
        "elastic": (0.147867218987404, 0.1682727008662497, 0.01318417840551),
    }
    first, last, cost = ends[tendon]
    start, end = (
        {"x.position": x, "x.velocity": 0.0, "muscle.activation": a}
        for x, a in ((0.15, first), (0.14, last))
    )
    if tendon == "elastic":
        stretch = 1.0 + math.log((0.1635 + 0.2) / 0.2) * 0.1 / math.log(6.0)
        for place, x in ((start, 0.15), (end, 0.14)):
            along, height = x - 0.05 * stretch, 0.1 * math.sin(0.1)
            place["muscle.fiber_length"] = math.hypot(along, height)
    scene = mbd.scene_from(
        {
            "robot": {"gravity": [9.81, 0.0, 0.0]},
            "muscles": [{**MUSCLE, "tendon": tendon}],
            "initial": {"position": {"x": 0.15}},
        },
        urdf=robot,
    )
    task = {
        "duration": 0.5,
        "start": start,
        "end": end,
        "goals": [{"type": "integral", "of": "muscle.excitation", "power": 2}],
    }
    return scene, task, cost


def hopper():
    """A body of 10 kg over a foot of 1 kg on smooth ground hops 0.15 m; minimum force squared."""
    robot = urdf(
        link("foot", 1.0),
        link("body", 10.0),
        joint("height", "prismatic", "ground", "foot", "0 1 0"),
        joint("leg", "prismatic", "foot", "body", "0 1 0"),
    )
    body, foot = 0.5455590472745554, -0.005390952725444551
    ground = {"type": "smooth_ground", "frame": "foot", "stiffness": 2.0e4, "normal": [0, 1, 0]}
    spring = {"type": "joint_spring", "joint": "leg", "stiffness": 2000.0, "rest": 0.6}
    scene = mbd.scene_from(
        {
            "robot": {"gravity": [0.0, -9.81, 0.0]},
            "actuators": drives("leg"),
            "forces": [ground | {"dissipation": 0.5, "smoothing": 1.0e-3}, spring],
            "initial": {"position": {"height": foot, "leg": body - foot}},
        },
        urdf=robot,
    )
    task = {
        "duration": 0.8,
        "end": {
            "leg.position": body - foot,
            "leg.velocity": 0.0,
            "height.velocity": 0.0,
            "height.position": foot + 0.15,
        },
        "goals": [{"type": "effort"}],
        "tolerance": 1.0e-6,
        "guess": {
            "height.position": [foot, foot, foot, foot + 0.15],
            "leg.position": [body - foot, body - foot - 0.12, body - foot],
        },
    }
    return scene, task, 1153.647245172
