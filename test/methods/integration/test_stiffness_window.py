"""The window of the stiffness of compliant contacts: stated, and measured by simulation."""

import math

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.errors import DivergedError
from mbd_ros.methods.integration import stiffness_window as bouncing
from mbd_ros.methods.integration.linear_motion import LinearMotion, SpringMotion
from mbd_ros.methods.integration.stiffness_window import ContactMotion, touching_motion, windows
from mbd_ros.scene.reading.part_entries import build_part

G, DT = 9.81, 1.0e-3
EXPLICIT = {"type": "semi_implicit_euler"}
IMPLICIT = {"type": "semi_implicit_euler", "damping": "implicit"}
RK4 = {"type": "rk4"}


def body(shape, mass, height, contact, **more):
    """A body over the ground."""
    return mbd.scene_from(
        {
            "bodies": {"body": {"shape": shape, "mass": mass}},
            "contacts": [{"type": "compliant", "between": ["body", "ground"], **contact}],
            "initial": {"pose": {"body": {"xyz": [0.0, 0.0, height]}}},
            "dt": DT,
            **more,
        }
    )


def ball(a, b, entry, mass=3.0, radius=0.1, dt=DT):
    """A ball at rest, with k dt^2/m = a and c dt/m = b."""
    stiffness = a * mass / dt**2
    contact = {"stiffness": stiffness, "dissipation": b * mass / dt}
    height = radius - mass * G / stiffness
    return body({"sphere": radius}, mass, height, contact, integrator=entry, dt=dt)


def motion_of(scene):
    """The motion of its contacts at the start."""
    (x,) = scene.simulation().run(scene.initial, 0.0)
    return touching_motion(scene.system(), scene.parts["contacts"], x)


def stated(scene):
    """The windows at the start."""
    return windows(motion_of(scene), scene.integrator, scene.dt)


def is_bounded(scene, steps=400):
    """Reference X04: whether a small push at rest in contact stays below 100 times itself."""
    rng, nv = np.random.default_rng(2), scene.robot.model.nv
    push = 1e-6 * (1.0 + 0.1 * rng.normal(size=nv))
    x, most = scene.initial._replace(v=push), 0.0
    try:
        with np.errstate(all="ignore"):
            for state in scene.simulation().run(x, steps * scene.dt):
                most = max(most, float(np.abs(state.v).max()))
                if not most <= 100.0 * np.abs(push).max():
                    return False
    except DivergedError:
        return False
    return True


LIMITS = [
    *((EXPLICIT, b, 4.0 - 2.0 * b) for b in (0.0, 0.3, 1.2)),
    *((IMPLICIT, b, 4.0 + 2.0 * b) for b in (0.0, 0.3, 3.0)),
    (RK4, 0.0, 8.0),
]


@pytest.mark.parametrize(("entry", "b", "limit"), LIMITS)
def test_measured_limits_are_those_stated(entry, b, limit):
    """Reference X04: a + 2 b < 4, a < 4 + 2 b and a < 8, within 1 %."""
    (window,) = stated(ball(0.5, b, entry))
    assert window.upper * DT**2 / 3.0 == pytest.approx(limit, rel=5e-5)
    assert is_bounded(ball(0.99 * limit, b, entry))
    assert not is_bounded(ball(1.01 * limit, b, entry), 500)


@pytest.mark.parametrize(
    ("entry", "b"),
    [
        *((RK4, 0.3), ({"type": "dopri5"}, 0.2), ({"type": "dop853"}, 0.0)),
        *(({"type": "gauss_legendre"}, 0.1), ({"type": "moreau_jean"}, 0.1)),
    ],
)
def test_limits_without_a_formula_are_measured_too(entry, b):
    (window,) = stated(ball(0.2, b, entry))
    if window.upper == math.inf:
        assert not window_method(entry).is_explicit
        assert is_bounded(ball(40.0, b, entry))
        return
    a = window.upper * DT**2 / 3.0
    assert is_bounded(ball(0.99 * a, b, entry), 500)
    assert not is_bounded(ball(1.01 * a, b, entry), 1500)


def window_method(entry):
    return build_part("integrators", entry, "here")


def test_positions_are_the_sequence_of_the_reference():
    """Reference X04, undamped with a = 1 and 3.99."""
    for a, numbers in (
        (1.0, [1, 0, -1, -1, 0, 1, 1]),
        (3.99, [1, -2.99, 4.9501, -6.860699, 8.70269101, -10.4576561099]),
    ):
        scene = ball(a, 0.0, EXPLICIT)
        rest = scene.initial.q[2]
        q = scene.initial.q.copy()
        q[2] += 1e-2 * (0.1 - rest)
        found = scene.simulation().run(scene.initial._replace(q=q), (len(numbers) - 1) * DT)
        heights = np.array([x.q[2] - rest for x in found]) / (q[2] - rest)
        assert heights == pytest.approx(numbers, abs=1e-8)


BRISTLE = {"friction": 0.5, "bristle_stiffness": 1e3, "bristle_damping": 60.0}
RUBBING = {
    "smooth": {},
    "creep": {"friction": 0.5, "creep": 0.05, "dissipation": 50.0},
    "bristle": {**BRISTLE, "dissipation": 50.0},
}


def box(stiffness, rubbing, entry):
    """A box of 2 kg on its four lower corners, at rest."""
    contact = {"stiffness": stiffness, **rubbing}
    height = 0.05 - 2.0 * G / (4.0 * stiffness)
    shape = {"box": [0.3, 0.2, 0.1]}
    return body(shape, 2.0, height, contact, integrator=entry)


def is_confirmed(upper, rubbing, entry):
    """Whether a step 5 % inside is bounded, and one 5 % outside is not."""
    return is_bounded(box(0.95 * upper, rubbing, entry), 200) and not is_bounded(
        box(1.05 * upper, rubbing, entry), 200
    )


@pytest.mark.parametrize("entry", [EXPLICIT, IMPLICIT, RK4], ids=["explicit", "implicit", "rk4"])
@pytest.mark.parametrize("rubs", RUBBING)
def test_the_window_of_four_contacts_is_the_one_that_simulation_confirms(rubs, entry):
    scene = box(1e5, RUBBING[rubs], entry)
    (window,) = stated(scene)
    assert window.features == 4
    assert window.load == pytest.approx(2.0 * G / 4.0)
    assert window.lower == pytest.approx(window.load / window.part.max_penetration)
    assert is_confirmed(window.upper, RUBBING[rubs], entry)
    if rubs != "smooth":
        return
    motion = motion_of(scene)
    for wrong in (0.9, 1.1):  # planted: another inverse effective mass
        (planted,) = windows(ContactMotion(motion.features, wrong * motion.A), *of(scene))
        assert not is_confirmed(planted.upper, RUBBING[rubs], entry)


def of(scene):
    return scene.integrator, scene.dt


def test_the_inverse_mass_of_a_box_is_that_of_the_textbook():
    """A_zz = 1/m + y^2/I_x + x^2/I_y at a corner, and 1/m + (y y')/I_x + (x x')/I_y across."""
    motion = motion_of(box(1e5, {}, EXPLICIT))
    m, (lx, ly, lz) = 2.0, (0.3, 0.2, 0.1)
    inertia = m / 12.0 * np.array([ly**2 + lz**2, lx**2 + lz**2])
    corners = [(s * lx / 2.0, r * ly / 2.0) for r in (-1, 1) for s in (-1, 1)]
    expected = [[1.0 / m + y * p / inertia[0] + x * o / inertia[1] for o, p in corners]
                for x, y in corners]  # fmt: skip
    assert motion.A[::3, ::3] == pytest.approx(np.array(expected), rel=1e-9)


SLIDERS = """<robot name="sliders"><link name="world"/>{}</robot>"""
SLIDER = """<link name="{0}"><inertial><mass value="{1}"/><inertia ixx="1" iyy="1" izz="1" ixy="0"
 ixz="0" iyz="0"/></inertial></link><joint name="{0}_rail" type="prismatic"><parent link="world"/>
<child link="{0}"/><axis xyz="0 0 1"/><limit lower="-9" upper="9" effort="1" velocity="1"/>
</joint>"""


@pytest.mark.parametrize("solver", ["reduced", "kkt", "qp"])
def test_couplings_and_loops_count_in_the_effective_mass(solver):
    """m + r^2 m' of a slider that moves another one, in every tier."""
    urdf = SLIDERS.format(SLIDER.format("one", 2.0) + SLIDER.format("two", 0.5))
    coupling = {"couplings": {"two_rail": {"parent": "one_rail", "factor": -3.0}}}
    if solver != "reduced":
        bar = {"type": "distance", "frame_a": "one", "frame_b": "two", "distance": 1.0}
        bar |= {"point_a": [0.0, 0.0, 1.0]}
        coupling = {"constraints": [bar], "solver": {"type": solver}}
    contact = {"type": "compliant", "between": [{"frame": "one", "sphere": 0.0}, "ground"]}
    scene = mbd.scene_from(
        {
            **coupling,
            "contacts": [{**contact, "stiffness": 1e5, "max_penetration": 1e-3}],
            "integrator": EXPLICIT,
            "dt": DT,
        },
        urdf=urdf,
    )
    mass = 2.0 + 9.0 * 0.5 if solver == "reduced" else 2.5
    (window,) = stated(scene)
    assert window.upper == pytest.approx(4.0 * mass / DT**2, rel=5e-5)
    weight = abs(2.0 - 3.0 * 0.5) * G if solver == "reduced" else 2.5 * G
    assert window.load == pytest.approx(weight, rel=1e-9)
    assert window.lower == pytest.approx(weight / 1e-3, rel=1e-9)


@pytest.mark.parametrize("method", ["dop853", "moreau_jean"])
def test_rigid_contacts_hold_what_they_carry(method):
    """A ball on a box that stands on the ground: all of its weight, on what does not move."""
    top = {"frame": "box", "half_space": [0, 0, 1], "xyz": [0, 0, 0.1]}
    soft = {"type": "compliant", "between": ["ball", top], "stiffness": 1e5}
    scene = mbd.scene_from(
        {
            "bodies": {
                "box": {"shape": {"box": [0.2, 0.2, 0.2]}, "mass": 1.0},
                "ball": {"shape": {"sphere": 0.1}, "mass": 2.0},
            },
            "contacts": [{"type": "rigid", "between": ["box", "ground"], "friction": 0.5}, soft],
            "initial": {"pose": {"box": {"xyz": [0, 0, 0.1]}, "ball": {"xyz": [0, 0, 0.3]}}},
            "integrator": {"type": method},
            "dt": DT,
        }
    )
    (x,) = scene.simulation().run(scene.initial, 0.0)
    motion = touching_motion(scene.system(), scene.parts["contacts"][1:], x)
    assert motion.features[0].load == pytest.approx(2.0 * G, rel=1e-9)
    assert motion.A[0, 0] == pytest.approx(0.5, rel=1e-9)


@pytest.mark.parametrize(("mass", "radius", "dt"), [(1e6, 10.0, 0.01), (1e-6, 1e-3, 1e-5)])
def test_windows_scale_with_the_scene(mass, radius, dt):
    (window,) = stated(ball(0.5, 0.0, EXPLICIT, mass, radius, dt))
    assert window.upper == pytest.approx(4.0 * mass / dt**2, rel=5e-5)
    assert window.lower == pytest.approx(mass * G / (0.01 * radius), rel=1e-9)


def test_a_stack_of_mass_ratio_1e6_has_a_window_a_contact():
    """Loads are the weights above; contacts that do not move one another go by themselves."""
    boxes = {f"box_{i}": {"shape": {"box": [1.0, 1.0, 1.0]}, "mass": m}
             for i, m in enumerate((1.0, 1.0, 1e6))}  # fmt: skip
    sides = [("box_0", "ground"), ("box_1", "box_0"), ("box_2", "box_1")]
    corners = [[x, y, -0.5] for x in (-0.5, 0.5) for y in (-0.5, 0.5)]
    contacts = [
        {
            **{"type": "compliant", "stiffness": 1e9},
            "between": [
                {"frame": a, "points": corners},
                b if b == "ground" else {"frame": b, "half_space": [0, 0, 1], "xyz": [0, 0, 0.5]},
            ],
        }
        for a, b in sides
    ]
    pose = {f"box_{i}": {"xyz": [0.0, 0.0, 0.5 + i]} for i in range(3)}
    alone = {"apart": {"shape": {"sphere": 0.1}, "mass": 1.0}}
    contacts.append({"type": "compliant", "between": ["apart", "ground"], "stiffness": 1e3})
    pose["apart"] = {"xyz": [5.0, 0.0, 3.0]}
    scene = mbd.scene_from(
        {
            "bodies": {**boxes, **alone},
            "contacts": contacts,
            "initial": {"pose": pose},
            "integrator": EXPLICIT,
            "dt": DT,
        }
    )
    found = stated(scene)
    weights = [(1e6 + 2.0) * G / 4.0, (1e6 + 1.0) * G / 4.0, 1e6 * G / 4.0]
    assert [w.load for w in found[:3]] == pytest.approx(weights, rel=1e-7)
    assert found[0].upper == pytest.approx(found[2].upper)
    assert found[3].upper == pytest.approx(4.0 / DT**2, rel=5e-5)


def test_rebounds_of_the_reference():
    """Reference X04: undamped impacts rebound up to 1.06, 1.25, 2 and 2.8 times as fast."""
    method = window_method(EXPLICIT)
    for a, gain in ((0.5, 1.06), (1.5, 1.25), (3.0, 2.0), (3.8, 2.8)):
        assert bouncing.rebound(method, a, 0.0) == pytest.approx(gain, abs=0.1)


METHODS = ("moreau_jean", "gauss_legendre", "generalized_alpha", "rattle", "adams")


@pytest.mark.parametrize(
    "entry", [EXPLICIT, RK4, *({"type": name} for name in METHODS)], ids=lambda e: e["type"]
)
@pytest.mark.parametrize("b", [0.0, 0.1])
def test_no_impact_below_its_bound_gains_speed(entry, b):
    """A mass on a rail meets a spring at all times of a step."""
    urdf = SLIDERS.format(SLIDER.format("one", 2.0))
    contact = {"type": "compliant", "between": [{"frame": "one", "sphere": 0.0}, "ground"]}
    contact |= {"stiffness": 1e5, "dissipation": b * 2.0 / DT}
    scene = mbd.scene_from(
        {"gravity": [0, 0, 0], "contacts": [contact], "integrator": entry, "dt": DT}, urdf=urdf
    )
    (window,) = stated(scene)
    assert window.lower == 0.0
    fastest = []
    for share in (0.3, 1.0):
        stiffness = share * window.impacts
        other = scene.with_({"one_contact.stiffness": stiffness})
        for phase in np.arange(0.1, 1.0, 0.2):
            q, v = np.array([(8.0 + phase) * DT]), np.array([-1.0])
            run = other.simulation().run(scene.initial._replace(q=q, v=v), 40 * DT)
            fastest.append(max(float(x.v[0]) for x in run))
    assert max(fastest) <= 1.0 + 1.5 * bouncing.GAIN


@pytest.mark.parametrize("entry", [EXPLICIT, IMPLICIT, RK4], ids=["explicit", "implicit", "rk4"])
def test_springs_grow_where_the_whole_matrix_of_a_step_says_so(entry):
    """Random springs, dampers and bristles, some of which lag too much for their dampers."""
    method, rng, answers = window_method(entry), np.random.default_rng(8), []
    for size in np.geomspace(0.02, 5.0, 60):
        K, C = (part @ part.T for part in rng.normal(size=(2, 3, 3)))
        tips, bends = rng.normal(size=(2, 3)), rng.uniform(0.1, 1.0, 2)
        held = tips.T @ tips * rng.uniform(0.0, 1.0)
        springs = SpringMotion(size * K, 0.1 * size * C + held, tips, bends)
        whole = LinearMotion(springs.stiffness, springs.damping)
        answers.append(method.growth(springs, 1.0) <= 1.0 + 1e-6)
        assert answers[-1] == (method.growth(whole, 1.0) <= 1.0 + 1e-6)
    assert 5 < sum(answers) < 58


def lines(scene, word):
    return [text for text in scene.check().splitlines() if word in text]


def test_check_names_a_stiffness_above_its_window_and_the_step_that_opens_it():
    scene = box(1e5, {}, EXPLICIT)
    (window,) = stated(scene)
    assert [line.split(":")[0] for line in lines(scene, "window")] == ["window      body_contact"]
    assert f"to {window.upper:.4g} (SemiImplicitEuler at dt 0.001 s)" in scene.check()
    stiff = box(3.0 * window.upper, {}, EXPLICIT)
    (line,) = lines(stiff, "above its window")
    assert "body_contact" in line and f"{window.lower:.4g} .. " in line
    longest = float(line.split("dt <")[1].split()[0])
    assert longest == pytest.approx(DT / math.sqrt(3.0), rel=0.01)
    assert not lines(stiff.with_(dt=0.99 * longest), "above its window")
    assert lines(stiff.with_(dt=1.01 * longest), "above its window")
    said = stiff.simulate(5 * DT).metadata["remarks"]
    assert any("warning: body_contact" in text and "above its window" in text for text in said)
    assert any(text.startswith("window of body_contact") for text in said)


def test_check_names_a_stiffness_below_its_window():
    scene = box(1e2, {}, {"type": "gauss_legendre"})
    (line,) = lines(scene, "below its window")
    assert "0.0491 m deep" in line and "max_penetration is 0.00187 m" in line
    assert "to any, which GaussLegendre follows" in lines(scene, "window  ")[0]
    hard = scene.with_({"body_contact.max_force": 19.62, "body_contact.max_penetration": 0.1})
    (window,) = stated(hard.with_({"body_contact.stiffness": 196.2}))
    assert window.lower == pytest.approx(196.2)


def test_check_names_a_start_that_is_too_deep():
    (line,) = lines(body({"sphere": 0.1}, 3.0, 0.08, {"stiffness": 1e5}), "deep at t = 0 s")
    assert "body_contact: 0.02 m deep" in line and "max_penetration is 0.001 m" in line


def test_an_empty_window_names_the_step_that_opens_it():
    scene = body(
        {"sphere": 0.1}, 3.0, 0.1, {"stiffness": 1e4, "max_penetration": 1e-6}, integrator=EXPLICIT
    ).with_(dt=2e-3)
    (line,) = lines(scene, "empty")
    opening = float(line.split("dt <")[1].split()[0])
    assert opening == pytest.approx(math.sqrt(4.0 * 1e-6 / G), rel=0.01)
    assert not lines(scene.with_(dt=0.98 * opening), "empty")


def test_friction_that_no_stiffness_mends_is_said():
    scene = box(1e5, {"friction": 0.5, "creep": 1e-6}, EXPLICIT)
    (line,) = lines(scene, "no stiffness is within its window")
    assert "body_contact" in line and "friction alone need steps of SemiImplicitEuler" in line


def test_the_largest_force_counts_in_friction_too():
    """A damper of 3/2 mu F/c along the tangents of a point that slides and turns nothing."""
    urdf = SLIDERS.format(SLIDER.format("one", 2.0)).replace('xyz="0 0 1"', 'xyz="1 0 0"')
    contact = {"type": "compliant", "between": [{"frame": "one", "sphere": 0.0}, "ground"]}
    contact |= {"stiffness": 1e5, "friction": 0.5, "creep": 0.01, "max_force": 40.0}
    scene = mbd.scene_from({"contacts": [contact], "integrator": EXPLICIT, "dt": DT}, urdf=urdf)
    damper = 1.5 * 0.5 * 40.0 / 0.01
    longest = 2.0 * 2.0 / damper
    for dt in (0.98 * longest, 1.02 * longest):
        said = lines(scene.with_(dt=dt), "no stiffness is within its window")
        assert bool(said) == (dt > longest)


def test_simulate_says_what_was_outside_on_the_way():
    """A bar falls on one corner: light there, and it goes deeper than it may."""
    contact = {"stiffness": 2e5, "max_penetration": 1e-3}
    scene = body({"box": [0.4, 0.1, 0.1]}, 2.0, 0.5, contact, integrator=RK4, dt=2e-4)
    said = scene.simulate(0.4).metadata["remarks"]
    assert any("max_penetration is 0.001 m" in text and "deep at t = " in text for text in said)
    assert not any("above its window" in text for text in said)


def test_hunt_and_crossleys_law_has_a_window_at_its_load():
    """The slope p F / d at a depth d = (F/k)^(1/p) is what a step must follow."""
    contact = {"law": "hunt_crossley", "stiffness": 1e8, "dissipation": 0.1}
    force, p = 3.0 * G, 1.5
    depth = (force / 1e8) ** (1.0 / p)
    scene = body({"sphere": 0.1}, 3.0, 0.1 - depth, contact, integrator=EXPLICIT)
    (window,) = stated(scene)
    slope, c = p * force / depth, 0.1 * force
    wanted = (4.0 - 2.0 * c * DT / 3.0) * 3.0 / DT**2 / slope
    assert window.upper == pytest.approx(1e8 * wanted**p, rel=1e-4)
    assert window.lower == pytest.approx(force / 1e-3**p, rel=1e-9)
    assert lines(scene, "N/m^1.5")


@pytest.mark.parametrize("share", [0.95, 1.05])
def test_the_window_of_hunt_and_crossley_is_confirmed(share):
    contact = {"law": "hunt_crossley", "stiffness": 1e8, "dissipation": 0.1}
    scene = body({"sphere": 0.1}, 3.0, 0.1, contact, integrator=EXPLICIT)
    (window,) = stated(scene)
    k = share**1.5 * window.upper
    height = 0.1 - (3.0 * G / k) ** (1.0 / 1.5)
    other = body({"sphere": 0.1}, 3.0, height, {**contact, "stiffness": k}, integrator=EXPLICIT)
    assert is_bounded(other) == (share < 1.0)
