"""What the section `contacts` accepts, what it says of it, and what it refuses by name."""

import numpy as np
import pytest
from mechanisms import chain, four_bar, four_bar_closure, scene_of

from mbd_ros.errors import MbdError, SceneError, SolveError
from mbd_ros.scene.describe.check import part_lines

BODIES = """
bodies:
  box: {shape: {box: [0.2, 0.2, 0.2]}, mass: 1, pose: {xyz: [0, 0, 0.1]}}
  drum: {shape: {cylinder: {radius: 0.1, length: 0.2}}, mass: 1, pose: {xyz: [1, 0, 0.1]}}
"""


def contacts(*entries, bodies=BODIES, more=""):
    return scene_of(f"{bodies}contacts: [{', '.join(entries)}]\n{more}")


def rigid(a, b, friction=0.5, more=""):
    return f"{{type: rigid, between: [{a}, {b}], friction: {friction}{more}}}"


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        (rigid("box", "ground", -0.1), r"contacts\[0\]\.friction: -0\.1 is out of range"),
        (rigid("box", "ground", [0.1] * 7), r"expected one number or 8: vertex_0"),
        (rigid("box", "ground", 0.1, ", restitution: 1.1"), r"restitution: 1\.1 is out of range"),
        (rigid("box", "ground", 0.1, ", restitution: -1"), r"restitution: -1 is out of range"),
        (rigid("box", "ground", 0.1, ", margin: -1"), r"margin: -1 is out of range"),
        (rigid("nose", "ground"), r"between\[0\]: no frame 'nose'; the links are"),
        (rigid("{frame: nose, sphere: 1}", "ground"), r"between\[0\]: no frame 'nose'"),
        (rigid("box", "{frame: box}"), r"between\[1\]: expected one shape of sphere, points"),
        (rigid("box", "{sphere: 1, box: [1, 1, 1]}"), "expected one shape .* got sphere, box"),
        (rigid("box", "{sphere: -1}"), r"between\[1\]\.sphere\.size: -1 is out of range"),
        (rigid("box", "{box: [1, 0, 1]}"), r"between\[1\]\.box"),
        (rigid("box", "{half_space: [0, 0, 0]}"), "normal .* must have a direction"),
        (rigid("box", "{capsule: {radius: 1}}"), r"capsule: key 'length' is missing"),
        (rigid("box", "{points: []}"), "0 points, accepted are 1 .. 200"),
        (
            rigid("box", "{sphere: 1, colour: 2}"),
            "unknown key 'colour', accepted: frame, xyz, rpy",
        ),
        (rigid("box", "box"), "have no relative motion"),
        (rigid("{frame: box, half_space: [0, 0, 1]}", "ground"), "contact of two half spaces"),
        (rigid("{sphere: 1}", "ground"), "have no relative motion"),
        ("{type: rigid, between: [box], friction: 0}", r"between: expected two sides, \[a, b\]"),
        ("{type: rigid, friction: 0}", "key 'between' is missing"),
        ("{type: stiff, between: [box, ground]}", "unknown type 'stiff', accepted: compliant, ri"),
    ],
)
def test_bad_input_is_named(entry, words):
    with pytest.raises(SceneError, match=words):
        contacts(entry)


def test_names_of_contacts_are_those_of_what_moves():
    scene = contacts(
        rigid("box", "ground"),
        rigid("ground", "drum"),
        rigid("drum", "ground", 0.1, ", name: roll"),
    )
    assert [part.name for part in scene.constraints] == ["box_contact", "drum_contact", "roll"]
    assert scene.constraints[0].rows[4].name == "vertex_1_friction_x"


def test_check_says_which_contacts_can_be_event_driven_and_why_others_can_not():
    scene = contacts(rigid("box", "ground"), rigid("drum", "ground"))
    smooth, rough = (text for label, text in part_lines(scene) if label == "contact")
    assert "box_contact, Rigid between box and world, 8 features: vertex_0, vertex_1" in smooth
    assert "smooth, for event-driven integrators and moreau_jean" in smooth
    assert "for moreau_jean, not event-driven: the lowest point of the rim of a cyl" in rough


@pytest.mark.parametrize("method", ["rk4", "dopri5", "dop853", "gauss_legendre", "adams"])
def test_methods_that_look_for_events_refuse_gaps_with_kinks_by_name(method):
    scene = contacts(rigid("drum", "ground"))
    words = r"drum_contact \(the lowest point .*; accepted: moreau_jean, or points on"
    with pytest.raises(SceneError, match=words):
        scene.simulation(integrator={"type": method})
    assert scene.simulation(integrator={"type": "moreau_jean"})


def starting(scene, method="moreau_jean"):
    simulation = scene.simulation(integrator={"type": method})
    return simulation.system.expand(simulation.start(scene.initial))


def test_an_overlap_at_the_start_is_refused_with_its_depth():
    lower = BODIES.replace("[0, 0, 0.1]", "[0, 0, 0.07]")
    words = r"contact box_contact: box and world overlap by 0\.03 m at the start, at vertex_0, ve"
    with pytest.raises(SolveError, match=words):
        starting(contacts(rigid("box", "ground"), bodies=lower))
    digits = BODIES.replace("[0, 0, 0.1]", "[0, 0, 0.09999999]")
    assert starting(contacts(rigid("box", "ground"), bodies=digits)).q[2] == pytest.approx(0.1)


def test_an_overlap_is_lifted_out_where_the_contact_says_so():
    """A light box between the ground and a heavy one: both end above what they were in."""
    text = """
bodies:
  box: {shape: {box: [0.2, 0.2, 0.2]}, mass: 1, pose: {xyz: [0, 0, 0.05]}}
  lid: {shape: {box: [0.3, 0.3, 0.2]}, mass: 1e3, pose: {xyz: [0, 0, 0.2]}}
"""
    both = [rigid("box", "ground", 0.5, ", assemble: true") for _ in range(2)]
    both[1] = both[1].replace("box, ground", "lid, box")
    scene = contacts(*both, bodies=text)
    q = starting(scene).q
    assert q[[2, 9]] == pytest.approx([0.1, 0.3], abs=1e-9)
    assert q[[0, 1, 7, 8]] == pytest.approx(np.zeros(4), abs=1e-9)


def test_a_linkage_is_lifted_out_with_its_loop_closed():
    """A point of the coupler of a four-bar starts below a plane; the mechanism has one freedom."""
    side = "{frame: coupler_link, points: [[1.0, 0, 0]]}"
    plane = "{half_space: [0, 1, 0], xyz: [0, 1.2, 0]}"
    closure = str({"type": "loop_closure", **four_bar_closure()}).replace("'", "")
    scene = scene_of(
        f"constraints: [{closure}]\n"
        f"contacts: [{rigid(side, plane, 0.3, ', assemble: true')}]\n"
        "initial: {position: {crank: 0.9, coupler: -0.7, rocker: 1.5}}\n",
        four_bar(),
    )
    simulation = scene.simulation(integrator={"type": "moreau_jean"})
    y = simulation.start(scene.initial)
    k = simulation.system.k
    k.refresh(y.q, y.v)
    contact, loop = scene.constraints[1], scene.constraints[0]
    assert contact.pair.gaps(k)[0] == pytest.approx(0.0, abs=1e-9)
    assert np.abs(loop.residual(k, y)).max() <= 1e-12


def test_what_nothing_can_lift_is_an_error_by_name():
    """A hinge in the plane: its tip stays below it."""
    side = "{frame: rod_1, points: [[1, 0, 0]]}"
    entry = rigid(side, "{half_space: [0, 0, 1], xyz: [0, 0, 0.1]}", 0.3, ", assemble: true")
    with pytest.raises(MbdError, match=r"rod_1_contact\.normal"):
        starting(scene_of(f"contacts: [{entry}]", chain(1)))


LINK = """
<link name="foot"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
iyz="0"/></inertial>{}</link>
"""
COLLISION = '<collision><origin xyz="{}" rpy="0 0 0"/><geometry>{}</geometry></collision>'


def foot(*collisions, source=None):
    """A scene with a foot that flies and touches the ground by its collision geometry."""
    text = f'<robot name="foot">{LINK.format("".join(collisions))}</robot>'
    rest = f"contacts: [{rigid('foot', 'ground')}]\n"
    return scene_of(f"robot: {{base: floating}}\n{rest}", text)


def test_collisions_of_a_link_are_its_shapes():
    scene = foot(
        COLLISION.format("0 0 1", '<box size="0.2 0.4 0.6"/>'),
        COLLISION.format("1 0 0.5", '<sphere radius="0.1"/>'),
        COLLISION.format("2 0 0.5", '<cylinder radius="0.1" length="0.4"/>'),
    )
    pair = scene.constraints[0].pair
    names = [f"vertex_{i}_of_0" for i in range(8)] + ["sphere_of_1"]
    assert pair.features[:9] == tuple(names) and pair.features[9] == "low_0_of_2"
    system = scene.system()
    system.k.refresh(scene.initial.q, scene.initial.v)
    gaps = pair.gaps(system.k)
    assert gaps[:9] == pytest.approx([0.7] * 4 + [1.3] * 4 + [0.4], abs=1e-14)
    assert gaps[9:].min() == pytest.approx(0.3, abs=1e-14)


@pytest.mark.parametrize(
    ("collision", "words"),
    [
        ("", r"link 'foot' has no <collision>; with one or a shape: none has one; or give"),
        (COLLISION.format("0 0 0", '<box size="1 1"/>'), "size='1 1', expected 3 finite numbers"),
        (COLLISION.format("0 0 0", '<sphere radius="-1"/>'), "-1 is out of range"),
        (COLLISION.format("0 0 0", '<sphere radius="nan"/>'), "radius='nan', expected a finite"),
        (COLLISION.format("0 0 0", "<cone/>"), "geometry <cone>, accepted: box, sphere"),
        (COLLISION.format("0 0", '<sphere radius="1"/>'), "xyz='0 0', expected 3 finite numbers"),
        ("<collision/>", "has no geometry"),
        (
            COLLISION.format("0 0 0", '<mesh filename="no.stl"/>'),
            "no.stl cannot be read: No such file",
        ),
    ],
)
def test_what_is_wrong_with_a_collision_is_named(collision, words):
    with pytest.raises(SceneError, match=rf"contacts\[0\]\.between\[0\]: .*{words}"):
        foot(collision)


CUBE = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.1)])
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def write_mesh(path, vertices=CUBE, quads=QUADS):
    lines = [f"v {x} {y} {z}" for x, y, z in np.asarray(vertices).tolist()]
    lines += [f"f {' '.join(str(i + 1) for i in face)}" for face in quads]
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def test_a_convex_mesh_touches_by_its_vertices(tmp_path):
    file = write_mesh(tmp_path / "cube.obj")
    side = f"{{frame: box, mesh: {{file: {file}, scale: [1, 1, 2]}}, xyz: [0, 0, 0.1]}}"
    scene = contacts(rigid(side, "ground"))
    pair, system = scene.constraints[0].pair, scene.system()
    system.k.refresh(scene.initial.q, scene.initial.v)
    assert sorted(pair.gaps(system.k)) == pytest.approx([0.2] * 4 + [0.4] * 4, abs=1e-7)
    assert pair.is_smooth and len(pair.features) == 8


def test_a_mesh_that_is_not_there_or_not_convex_is_named(tmp_path):
    dented = CUBE.copy()
    dented[7] = (-0.05, -0.05, 0.02)
    write_mesh(tmp_path / "dented.obj", dented)
    (tmp_path / "empty.stl").write_text("solid\n", encoding="utf-8")
    write_mesh(tmp_path / "flat.obj", CUBE * (1, 1, 0), QUADS[4:5])
    for name, words in (
        ("none.stl", "mesh .*none.stl cannot be read: No such file"),
        ("empty.stl", "empty.stl holds no mesh"),
        ("dented.obj", r"dented.obj: the mesh is not convex: it is bent inwards by 0\.\d+ m"),
        ("flat.obj", "flat.obj: the mesh is flat"),
    ):
        with pytest.raises(SceneError, match=rf"between\[0\]\.mesh: .*{words}"):
            contacts(rigid(f"{{frame: box, mesh: {tmp_path / name}}}", "ground"))


ARM = """<robot name="arm"><link name="base"><collision><geometry><box size="1 1 0.2"/></geometry>
</collision></link>
<link name="finger"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
iyz="0"/></inertial></link>
<link name="tip"><inertial><origin xyz="0 0 -0.1"/><mass value="1"/><inertia ixx="1" iyy="1"
izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 -0.5"/><geometry>{}</geometry></collision></link>
<joint name="swing" type="revolute"><parent link="base"/><child link="finger"/>
<origin xyz="0 0 1"/><axis xyz="0 1 0"/>
<limit lower="-9" upper="9" effort="9" velocity="9"/></joint>
<joint name="slide" type="prismatic"><parent link="finger"/><child link="tip"/>
<axis xyz="0 0 -1"/><limit lower="-9" upper="9" effort="9" velocity="9"/></joint></robot>"""
SPHERE = '<sphere radius="0.05"/>'


def test_links_of_members_have_collisions_by_their_names_there(tmp_path):
    """Of two robots, the root of one by the name of the robot; and of a joint that is locked."""
    write_mesh(tmp_path / "cube.obj")
    (tmp_path / "arm.urdf").write_text(ARM.format(SPHERE), encoding="utf-8")
    mesh = '<mesh filename="cube.obj" scale="1 1 1"/>'
    (tmp_path / "other.urdf").write_text(ARM.format(mesh), encoding="utf-8")
    scene = scene_of(
        f"robots:\n  left: {{urdf: {tmp_path / 'arm.urdf'}, locked: {{slide: 0.1}}}}\n"
        f"  right: {{urdf: {tmp_path / 'other.urdf'}, pose: {{xyz: [3, 0, 0]}}}}\n"
        f"contacts: [{rigid('left/tip', 'ground')}, {rigid('right/tip', 'right')},"
        f"{rigid('left/tip', 'right/tip')}]\n"
    )
    ground, base, both = scene.constraints
    assert [part.name for part in scene.constraints] == [
        *("left/tip_contact", "right/tip_contact", "left/tip_contact_2"),
    ]
    system = scene.system()
    system.k.refresh(scene.initial.q, scene.initial.v)
    assert ground.pair.gaps(system.k) == pytest.approx([1.0 - 0.1 - 0.5 - 0.05], abs=1e-12)
    assert base.pair.clearance(system.k, base.pair.gaps(system.k)) == pytest.approx(0.4, abs=1e-6)
    assert both.pair.gaps(system.k) == pytest.approx([np.hypot(2.9, 0.1) - 0.05], abs=1e-6)


def test_a_coupled_arm_is_lifted_out_with_its_couplings_kept():
    """The slide follows the swing; its tip starts in the ground."""
    text = ARM.format(SPHERE)
    scene = scene_of(
        "couplings: {slide: {parent: swing, factor: 0.5, offset: 0.6}}\n"
        f"contacts: [{rigid('tip', 'ground', 0.4, ', assemble: true')}]\n",
        text,
    )
    q = starting(scene).q
    swing, slide = (scene.robot.joint(name).q for name in ("swing", "slide"))
    assert q[slide] == pytest.approx(0.5 * q[swing] + 0.6, abs=1e-12)
    height = 1.0 - (q[slide] + 0.5) * np.cos(q[swing])
    assert height == pytest.approx(0.05, abs=1e-9)


@pytest.mark.parametrize(("body", "method"), [("drum", "MoreauJean"), ("box", "Dopri5")])
def test_gaps_that_are_not_smooth_are_stepped_in_time_where_nobody_names_a_method(body, method):
    assert type(contacts(rigid(body, "ground")).simulation().integrator).__name__ == method
