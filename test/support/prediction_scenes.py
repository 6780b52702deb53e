"""Mechanisms with known best motions, as scenes of this package, and the tasks that ask for them.

References are from two independent methods each, Pontryagin's boundary value problem by multiple
shooting and Gauss collocation, to the digits given; O01 and O02 are closed forms.
"""

import math

import mbd_ros as mbd

EFFORT = [{"type": "effort"}]


def link(name, m, com="0 0 0", inertia=0.0):
    moments = " ".join(f"i{axis}='{inertia}'" for axis in ("xx", "yy", "zz"))
    return (
        f"<link name='{name}'><inertial><origin xyz='{com}'/><mass value='{m}'/>"
        f"<inertia {moments} ixy='0' ixz='0' iyz='0'/></inertial></link>"
    )


def joint(name, kind, parent, child, axis, origin="0 0 0"):
    limit = "<limit lower='-100' upper='100' effort='0' velocity='0'/>"
    return (
        f"<joint name='{name}' type='{kind}'><parent link='{parent}'/><child link='{child}'/>"
        f"<origin xyz='{origin}'/><axis xyz='{axis}'/>"
        f"{limit if kind == 'prismatic' else ''}</joint>"
    )


def urdf(*parts):
    return f"<robot name='r'><link name='ground'/>{''.join(parts)}</robot>"


def drives(*joints, limit=math.inf):
    entry = {"type": "ideal", "joints": list(joints)}
    return [entry | ({"limit": limit} if limit < math.inf else {})]


def cart_pole():
    """Kelly's: a cart of 1 kg and a pendulum of 0.3 kg at 0.5 m, which hangs at 0."""
    robot = urdf(
        link("cart", 1.0),
        link("pole", 0.3, "0 0 -0.5"),
        joint("slide", "prismatic", "ground", "cart", "1 0 0"),
        joint("swing", "continuous", "cart", "pole", "0 -1 0"),
    )
    return mbd.scene_from({"actuators": drives("slide", limit=20.0)}, urdf=robot)


SWING_UP = {
    "duration": 2.0,
    "bounds": {"slide.position": [-2.0, 2.0]},
    "end": {"slide.position": 1.0, "swing.position": math.pi, "*.velocity": 0.0},
    "goals": EFFORT,
}
SWING_UP_COST = 58.80766745817  # M. Kelly, SIAM Review 59, 2017, sec. 6: the published minimum


def mass(m=1.0, limit=math.inf, damping=0.0):
    """A mass on a rail."""
    robot = urdf(link("mass", m), joint("slide", "prismatic", "ground", "mass", "1 0 0"))
    damper = {"type": "joint_spring", "joint": "slide", "stiffness": 0.0, "damping": damping}
    forces = [damper] if damping else []
    return mbd.scene_from(
        {"actuators": drives("slide", limit=limit), "forces": forces}, urdf=robot
    )


def quickest():
    """Minimum time with a bounded force; the switch is in an interval. Pontryagin."""
    task = {"duration": [0.01, 5.0], "goals": [{"type": "time"}], "mesh": {"intervals": 7}}
    return mass(2.0, 50.0), task | {"end": {"slide.position": 1.0, "slide.velocity": 0.0}}, 0.4


def rest_to_rest():
    task = {"duration": 1.0, "end": {"slide.position": 1.0, "slide.velocity": 0.0}}
    return mass(), task | {"goals": EFFORT}, 12.0


def kirk():
    """D. E. Kirk, Optimal Control Theory, 1998, example 5.1-1."""
    task = {"duration": 2.0, "end": {"slide.position": 5.0, "slide.velocity": 2.0}}
    goals = [{"type": "effort", "weight": 0.5}]
    return mass(damping=1.0), task | {"goals": goals}, 16.75072339679631


def bryson_denham():
    """A. E. Bryson, Y.-C. Ho, Applied Optimal Control, 1975, sec. 3.11."""
    task = {
        "duration": 1.0,
        "start": {"slide.velocity": 1.0},
        "end": {"slide.position": 0.0, "slide.velocity": -1.0},
        "bounds": {"slide.position": [None, 1.0 / 9.0]},
        "goals": [{"type": "effort", "weight": 0.5}],
    }
    return mass(), task, 4.0


def two_links(start, couplings=None, solver=None):
    """Links of 1 m, 1 kg at the tip with 1 kg m^2 there."""
    robot = urdf(
        link("a", 1.0, "1 0 0", 1.0),
        link("b", 1.0, "1 0 0", 1.0),
        joint("q0", "continuous", "ground", "a", "0 0 1"),
        joint("q1", "continuous", "a", "b", "0 0 1", "1 0 0"),
    )
    sections = {
        "robot": {"gravity": [0.0, -9.80665, 0.0]},
        "actuators": drives("q0", "q1"),
        "initial": {"position": {"q0": start}},
    }
    sections |= {"couplings": couplings} if couplings else {}
    sections |= {"solver": solver} if solver else {}
    return mbd.scene_from(sections, urdf=robot)


def coupled_arm(solver=None):
    """Moco's testDoublePendulumCoordinateCoupler: q1 = pi - 2 q0."""
    couplings = {"q1": {"parent": "q0", "factor": -2.0, "offset": math.pi}}
    end = {"q0.position": math.pi / 2, "q0.velocity": 0.0}
    task = {"duration": 1.0, "end": end, "goals": EFFORT}
    return two_links(0.0, couplings, solver), task, 371.50283295457


def four_bar():
    """A crank-rocker, one turn from rest to rest; the loop is closed by rows."""
    rods = {"crank": (0.5, 0.1), "coupler": (2.0, 0.4), "rocker": (1.5, 0.3)}
    links = [link(n, m, f"{size / 2} 0 0", m * size**2 / 12) for n, (m, size) in rods.items()]
    robot = urdf(
        *links,
        joint("crank", "continuous", "ground", "crank", "0 0 1"),
        joint("coupler", "continuous", "crank", "coupler", "0 0 1", "0.1 0 0"),
        joint("rocker", "continuous", "ground", "rocker", "0 0 1", "0.4 0 0"),
    )
    ends = {"frame_a": "coupler", "point_a": [0.4, 0.0, 0.0]}
    ends |= {"frame_b": "rocker", "point_b": [0.3, 0.0, 0.0]}
    position = {"coupler": 0.84106867057, "rocker": 1.6821373411}
    scene = mbd.scene_from(
        {
            "robot": {"gravity": [0.0, -9.81, 0.0]},
            "actuators": drives("crank"),
            "constraints": [{"type": "loop_closure", "directions": "xy", **ends}],
            "initial": {"position": position},
        },
        urdf=robot,
    )
    end = {"crank.position": 2.0 * math.pi, "crank.velocity": 0.0}
    return scene, {"duration": 1.0, "end": end, "goals": EFFORT}, 0.5968733288904


def hanging_muscle(tendon):
    """Moco's exampleHangingMuscle, for least excitation, from equilibrium to equilibrium.

    The bound x <= 0.18 is part of the problem: beyond it the fiber is so long that its passive
    force carries the mass, and a motion through there costs less.
    """
    robot = urdf(link("mass", 0.5), joint("x", "prismatic", "ground", "mass", "1 0 0"))
    muscle = {
        "type": "degroote_fregly",
        "name": "m",
        "path": {"points": [{"frame": "world"}, {"frame": "mass"}]},
        "max_isometric_force": 30.0,
        "optimal_fiber_length": 0.1,
        "tendon_slack_length": 0.05,
        "tendon_strain": 0.1,
        "pennation_angle": 0.1,
        "minimum_activation": 1.0e-4,
        "tendon": tendon,
    }
    scene = mbd.scene_from(
        {
            "robot": {"gravity": [9.81, 0.0, 0.0]},
            "muscles": [muscle],
            "initial": {"position": {"x": 0.15}},
        },
        urdf=robot,
    )
    activations = {
        "rigid": (0.1453722025540807, 0.1643111234478267),
        "elastic": (0.147867218987404, 0.1682727008662497),
    }[tendon]
    ends = []
    for x, activation in zip((0.15, 0.14), activations, strict=True):
        ends.append({"x.position": x, "x.velocity": 0.0, "m.activation": activation})
        if tendon == "elastic":  # the tendon pulls with 0.1635 of the peak force
            slope = math.log(1.2 / 0.2) / 0.1
            along = x - 0.05 * (1.0 + math.log((0.1635 + 0.2) / 0.2) / slope)
            ends[-1]["m.fiber_length"] = math.hypot(along, 0.1 * math.sin(0.1))
    task = {"duration": 0.5, "start": ends[0], "end": ends[1], "goals": EFFORT}
    task["bounds"] = {"x.position": [0.05, 0.18]}
    return scene, task, 0.01272601618034 if tendon == "rigid" else 0.0131841784055


def biped():
    """RABBIT: five links, a step of 0.5 m in 0.7 s with a plastic impact. Kelly 2017, sec. 7."""
    legs = []
    for side in ("left", "right"):
        legs += [
            link(f"{side}_thigh", 6.8, "0 0 -0.163", 1.08),
            link(f"{side}_shank", 3.2, "0 0 -0.128", 0.93),
            f"<link name='{side}_foot'/>",
            joint(f"{side}_hip", "continuous", "torso", f"{side}_thigh", "0 -1 0"),
            joint(
                f"{side}_knee",
                "continuous",
                f"{side}_thigh",
                f"{side}_shank",
                "0 -1 0",
                "0 0 -0.4",
            ),
            joint(f"{side}_tip", "fixed", f"{side}_shank", f"{side}_foot", "1 0 0", "0 0 -0.4"),
        ]
    robot = urdf(
        "<link name='rail'/><link name='pelvis'/>",
        link("torso", 20.0, "0 0 0.425", 2.22),
        joint("travel", "prismatic", "ground", "rail", "1 0 0"),
        joint("height", "prismatic", "rail", "pelvis", "0 0 1"),
        joint("torso", "continuous", "pelvis", "torso", "0 -1 0"),
        *legs,
    )
    soles = [
        {
            "name": f"{side}_sole",
            "type": "rigid",
            "between": [
                {"frame": f"{side}_shank", "points": [[0.0, 0.0, -0.4]]},
                {"half_space": [0, 0, 1]},
            ],
            "friction": 1.5,
        }
        for side in ("left", "right")
    ]
    step = {
        "contacts": ["left_sole"],
        "until": {"strike": {"touch_down": "right_sole"}},
        "then": "step",
        "reset": {"exchange": {"left_hip": "right_hip", "left_knee": "right_knee"}},
    }
    angles = {"left_hip": (0.7, -0.5), "left_knee": (-1.0, -0.1)}
    angles |= {"right_hip": (-0.5, 0.7), "right_knee": (-0.1, -1.0)}
    hips = [_hip(-0.3, 0.7), _hip(-0.6, -0.5)]
    position = {name: first for name, (first, _) in angles.items()}
    position |= {"travel": hips[0][0], "height": hips[0][1]}
    scene = mbd.scene_from(
        {
            "contacts": soles,
            "actuators": drives(*angles),
            "phases": {"step": step},
            "initial": {"position": position},
        },
        urdf=robot,
    )
    guess = {f"{name}.position": list(ends) for name, ends in angles.items()}
    guess["travel.position"], guess["height.position"] = (
        [a, b] for a, b in zip(*hips, strict=True)
    )
    task = {
        "duration": 0.7,
        "periodic": True,
        "travel": ["travel"],
        "start": {"left_foot.position.x": 0.0},
        "end": {"right_foot.position.x": 0.5},
        "goals": EFFORT,
        "guess": guess,
    }
    return scene, task, 469.5019750705


def _hip(shank, thigh):
    """Where the hip is over the stance foot, by absolute angles."""
    return [-0.4 * (math.sin(shank) + math.sin(thigh)), 0.4 * (math.cos(shank) + math.cos(thigh))]


PROBLEMS = {  # name -> scene, task, cost; relative error that is accepted
    "quickest": (quickest, 1.0e-8),
    "rest_to_rest": (rest_to_rest, 1.0e-8),
    "kirk": (kirk, 1.0e-8),
    "bryson_denham": (bryson_denham, 1.0e-8),
    "coupled_arm_as_rows": (lambda: coupled_arm({"type": "kkt"}), 1.0e-8),
    "four_bar": (four_bar, 1.0e-8),
    "biped": (biped, 1.0e-7),
}
