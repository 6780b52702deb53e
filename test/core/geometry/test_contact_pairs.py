"""Features of pairs of shapes: gaps in closed form, Jacobian and drift against differences."""

import coal
import mechanisms
import numpy as np
import pinocchio as pin
import pytest
from contact_pairs import BODIES, OTHERS, PLANE, SMOOTH, random_states
from mechanisms import scene_of
from scipy.spatial import ConvexHull

from mbd_ros.core.geometry.contact_pair import contact_pair
from mbd_ros.core.geometry.convex import inside
from mbd_ros.core.geometry.shapes import (
    Between,
    Box,
    Capsule,
    Mesh,
    Side,
    box_of,
    line_of,
    polyhedron,
)
from mbd_ros.core.geometry.simple_bodies import _to_box, _to_mesh
from mbd_ros.core.kinematics.kinematics import Kinematics
from mbd_ros.core.state import State

PLACES = {"near": (0.0, 0.0, 0.0), "far": (100.0, -60.0, 30.0)}


def pair_of(a, b, more=""):
    entry = f"{{type: rigid, between: [{a}, {b}], friction: 0.5{more}}}"
    scene = scene_of(f"{BODIES}contacts: [{entry}]\n")
    (part,) = scene.constraints
    return scene, part.pair


def at(scene, pair, x, shift=0.0):
    """What the pair says a little later on a motion without joint accelerations."""
    k = Kinematics(scene.robot)
    q = pin.integrate(scene.robot.model, x.q, shift * x.v)
    k.refresh(q, x.v)
    return k, x._replace(q=q)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("case", [*SMOOTH, *OTHERS])
def test_rows_are_the_derivatives_of_gaps_and_of_one_another(case, place):
    a, b, count = {**SMOOTH, **OTHERS}[case]
    scene, pair = pair_of(a, b)
    assert len(pair.features) == len(set(pair.features)) == count
    assert pair.is_smooth == (case in SMOOTH) == (not pair.why_not)
    h = 1e-6
    tolerance = 1e-7 * (1.0 + 10.0 * np.abs(PLACES[place]).max())
    if case in ("box over box", "cylinder over box", "cylinder over cylinder"):
        return  # features beside the faces are no distances, see below
    for x in random_states(scene, 5, PLACES[place]):
        before, after = (at(scene, pair, x, shift) for shift in (-h, h))
        k, x = at(scene, pair, x)
        rates = pair.jacobian(k) @ x.v
        slope = (pair.gaps(after[0]) - pair.gaps(before[0])) / (2.0 * h)
        k, x = at(scene, pair, x)
        aside = [name.startswith(("left", "right")) for name in pair.features]  # slide on a rim
        assert np.where(aside, 0.0, slope - rates[::3]) == pytest.approx(0.0, abs=tolerance)
        slopes = [pair.jacobian(near) @ x.v for near, _ in (before, after)]
        drift = pair.drift(k, x)
        size = 1.0 + np.abs(drift).max()
        slope = (slopes[1] - slopes[0]) / (2.0 * h)
        turns = spin(pair, before[0], k, after[0]) / (2.0 * h)
        slope[1::3] -= turns * rates[2::3]
        slope[2::3] += turns * rates[1::3]
        assert slope == pytest.approx(drift, abs=tolerance * size)


def spin(pair, before, k, after):
    """How far frames turn about their normals in the shape at rest, which `drift` leaves out."""
    axes = [
        np.einsum("ij,nik->njk", near.rotation(pair._met[0].meeting.pair.a), near_axes)
        for near, near_axes in ((near, pair.places(near).axes) for near in (before, k, after))
    ]
    return np.einsum("nj,nj->n", (axes[2] - axes[0])[:, :, 0], axes[1][:, :, 1])


@pytest.mark.parametrize("case", [*SMOOTH, *OTHERS])
def test_rows_are_velocities_of_a_past_b_at_the_contact_point(case):
    """From the velocities of both bodies alone, which this test asks Pinocchio for."""
    a, b, _ = {**SMOOTH, **OTHERS}[case]
    scene, pair = pair_of(a, b)
    for x in random_states(scene, 3):
        k, x = at(scene, pair, x)
        point, axes = pair.places(k)
        data = scene.robot.model.createData()
        pin.forwardKinematics(scene.robot.model, data, x.q, x.v)
        speeds = []
        for side in pair.between:
            joint = scene.robot.model.frames[scene.robot.frame(side.frame)].parentJoint
            motion = data.oMi[joint].act(data.v[joint])
            speeds.append(motion.linear + np.cross(motion.angular, point))
        past = np.einsum("nij,ni->nj", axes, speeds[0] - speeds[1])
        assert pair.jacobian(k) @ x.v == pytest.approx(past[:, [2, 0, 1]].ravel(), abs=1e-12)
        assert np.einsum("nij,nik->njk", axes, axes) == pytest.approx(
            np.broadcast_to(np.eye(3), axes.shape), abs=1e-13
        )
        assert np.linalg.det(axes) == pytest.approx(np.ones(len(axes)))


def test_both_orders_of_a_pair_say_the_same():
    """Gaps are equal and normals opposite, whichever of two bodies is called a."""
    for a, b in (("ball", PLANE), ("box", PLANE)):
        scene, pair = pair_of(a, b)
        other, back = pair_of(b, a)
        for x in random_states(scene, 3):
            (k, _), (other_k, _) = at(scene, pair, x), at(other, back, x)
            assert pair.gaps(k) == pytest.approx(back.gaps(other_k), abs=1e-14)
            one, two = pair.places(k), back.places(other_k)
            assert one.point == pytest.approx(two.point, abs=1e-14)
            assert one.axes[:, :, 2] == pytest.approx(-two.axes[:, :, 2], abs=1e-14)


def test_gaps_are_those_of_hand():
    """Bodies stand where `BODIES` puts them, without rotation."""
    expected = {
        ("box", "ground"): [0.7] * 4 + [1.1] * 4,
        ("ball", "ground"): [0.2],
        ("pill", "ground"): [-0.2, 0.1],
        ("ball", "{sphere: 0.2, xyz: [0.5, -0.4, 1.0]}"): [0.4],
        ("{frame: ball, points: [[0.1, 0, 0], [0, 0, -0.4]]}", "ground"): [0.3, -0.1],
    }
    for (a, b), gaps in expected.items():
        scene, pair = pair_of(a, b)
        k, _ = at(scene, pair, scene.initial)
        assert pair.gaps(k) == pytest.approx(gaps, abs=1e-14)
        scene, pair = pair_of(a, b, ", margin: 0.01")
        k, _ = at(scene, pair, scene.initial)
        assert pair.gaps(k) == pytest.approx(np.array(gaps) - 0.01, abs=1e-14)


def test_frames_that_do_not_move_against_each_other_are_refused():
    arm = mechanisms.chain(2)
    for a, b in (("{points: [[0, 0, 1]]}", "ground"), ("{frame: rod_1, sphere: 1}",) * 2):
        text = f"contacts: [{{type: rigid, between: [{a}, {b}], friction: 0}}]"
        with pytest.raises(Exception, match=r"contacts\[0\].*have no relative motion"):
            scene_of(text, arm)


def boxes():
    scene, pair = pair_of("box", "wedge")
    return scene, pair, np.array((0.2, 0.3, 0.4)), np.array((1.0, 1.0, 1.0))


def placed(scene, pose):
    """The state with the box at a pose and the wedge at the origin, both at rest."""
    q = scene.initial.q.copy()
    for base in scene.robot.bases:
        own = pose if base.name == "box" else pin.SE3.Identity()
        q[base.q] = pin.SE3ToXYZQUAT(own)
    k = Kinematics(scene.robot)
    k.refresh(q, np.zeros(scene.robot.model.nv))
    return k, q


def nearing(a, b, pose, distance):
    """A pose on the way of a towards b at which they are so far apart, by coal."""
    solids = coal.Box(*a), coal.Box(*b)

    def apart(at):
        request, result = coal.DistanceRequest(), coal.DistanceResult()
        places = coal.Transform3s(at.rotation, at.translation), coal.Transform3s()
        return coal.distance(solids[0], places[0], solids[1], places[1], request, result)

    way = pose.translation / np.linalg.norm(pose.translation)
    far, near = 2.0, 0.0
    for _ in range(60):
        middle = 0.5 * (far + near)
        is_far = apart(pin.SE3(pose.rotation, middle * way)) > distance
        far, near = (middle, near) if is_far else (far, middle)
    return pin.SE3(pose.rotation, far * way)


@pytest.mark.parametrize("distance", [1e-3, 1e-5])
def test_features_of_boxes_know_the_distance_of_boxes(distance):
    """Random boxes that nearly touch, a vertex over a face or two edges; coal says how far."""
    scene, pair, a, b = boxes()
    rng, found = np.random.default_rng(4), []
    for _ in range(100):
        turn = pin.exp3(rng.normal(size=3) * 2.0)
        pose = nearing(a, b, pin.SE3(turn, rng.normal(size=3)), distance)
        k, _ = placed(scene, pose)
        gaps = pair.gaps(k)
        found.append(pair.features[int(np.argmin(gaps))].split("_")[0])
        assert gaps.min() == pytest.approx(distance, rel=0.02)
    assert {"a", "b", "edge"} == set(found)


def test_rows_of_boxes_are_derivatives_where_they_touch():
    """Of every feature that is on both boxes, in random poses of a near touch."""
    scene, pair, a, b = boxes()
    rng, h, seen = np.random.default_rng(5), 1e-7, set()
    for _ in range(60):
        turn = pin.exp3(rng.normal(size=3) * 2.0)
        k, q = placed(scene, nearing(a, b, pin.SE3(turn, rng.normal(size=3)), 1e-4))
        x = State(0.0, q, rng.normal(size=scene.robot.model.nv))
        near = int(np.argmin(pair.gaps(k)))
        rows = slice(3 * near, 3 * near + 3)
        k, _ = at(scene, pair, x)
        rate, drift = (pair.jacobian(k) @ x.v)[rows], pair.drift(k, x)[rows]
        ends = [at(scene, pair, x, shift)[0] for shift in (-h, h)]
        gaps = [pair.gaps(end)[near] for end in ends]
        rates = [(pair.jacobian(end) @ x.v)[rows] for end in ends]
        assert (gaps[1] - gaps[0]) / (2 * h) == pytest.approx(rate[0], abs=1e-6)
        slope = (rates[1] - rates[0]) / (2 * h)
        slope[1:] += spin(pair, ends[0], k, ends[1])[near] / (2 * h) * rate[[2, 1]] * (-1.0, 1.0)
        assert slope == pytest.approx(drift, abs=2e-5)
        seen.add(pair.features[near].split("_")[0])
    assert {"a", "b", "edge"} == seen


def shared_area(a, b, yaw, offset):
    """Area that two rectangles share, by cutting one at the four sides of the other."""
    turn = np.array(((np.cos(yaw), -np.sin(yaw)), (np.sin(yaw), np.cos(yaw))))
    corners = np.array(((-1, -1), (1, -1), (1, 1), (-1, 1))) * a[:2] / 2.0
    region = list(corners @ turn.T + offset)
    for axis in (0, 1):
        for sign in (-1.0, 1.0):
            inside = [b[axis] / 2.0 - sign * point[axis] for point in region]
            cut = []
            for i, point in enumerate(region):
                after, here, there = region[i - 1], inside[i], inside[i - 1]
                if here * there < 0.0:
                    cut.append(point + (after - point) * here / (here - there))
                if here >= 0.0:
                    cut.append(point)
            region = cut
    x, y = np.array(region).T
    return 0.5 * abs(x @ np.roll(y, 1) - y @ np.roll(x, 1)), len(region)


@pytest.mark.parametrize("on_top", [True, False])
def test_what_touches_of_two_faces_is_the_region_that_they_share(on_top):
    """For random turns and offsets: as many features as it has corners, around the same area."""
    scene, pair, a, b = boxes()
    rng = np.random.default_rng(6)
    b = b if on_top else b[[1, 2, 0]]
    for i in range(80):
        yaw, offset = rng.uniform(-3.0, 3.0), rng.uniform(-0.55, 0.55, 2)
        if i < 4:  # long thin overlaps and boards that cross
            yaw, offset = i * np.pi / 2.0 + 1e-7, np.array((0.48, 0.0))
        height = (a[2] + b[2]) / 2.0 - 1e-9
        pose = pin.SE3(pin.exp3(np.array((0, 0, yaw))), np.array((*offset, height)))
        k, _ = placed(scene, pose)
        touching = np.abs(pair.gaps(k)) < 1e-8
        area, corners = shared_area(a, b, yaw, offset)
        assert touching.sum() == corners
        points = pair.places(k).point[touching, :2]
        assert ConvexHull(points).volume == pytest.approx(area, abs=1e-6)
        normals = pair.places(k).axes[touching, :, 2]
        assert normals == pytest.approx(np.tile((0.0, 0.0, 1.0), (len(points), 1)), abs=1e-12)


@pytest.mark.parametrize("noise", [0.0, 1e-16, 1e-12, 1e-8])
def test_equal_faces_touch_at_their_four_corners(noise):
    """Boxes of one size on one another, with rounding or a little more in their poses."""
    scene = scene_of(
        "bodies:\n"
        "  lower: {shape: {box: [0.3, 0.2, 0.1]}, mass: 1}\n"
        "  upper: {shape: {box: [0.3, 0.2, 0.1]}, mass: 1, pose: {xyz: [0, 0, 0.1]}}\n"
        "contacts: [{type: rigid, between: [upper, lower], friction: 0.5}]\n"
    )
    (part,), rng = scene.constraints, np.random.default_rng(7)
    for _ in range(20):
        dv = noise * rng.normal(size=scene.robot.model.nv)
        k, _ = at(scene, part.pair, State(0.0, scene.initial.q, dv), 1.0)
        touching = np.abs(part.pair.gaps(k)) < 20.0 * noise + 1e-15
        assert [n for n, is_on in zip(part.features, touching, strict=True) if is_on] == [
            "a_0",
            "a_1",
            "a_2",
            "a_3",
        ]


@pytest.mark.parametrize("plane", ["ground", "{half_space: [0, 0, 1]}"])
@pytest.mark.parametrize("base", ["floating", "fixed"])
def test_the_ground_is_at_rest_though_a_link_is_called_world(base, plane):
    """A robot whose root link is `world` stands 2 m high; its foot is 2 m above the ground."""
    text = f"""
robot: {{base: {base}, pose: {{xyz: [0, 0, 2]}}}}
contacts: [{{type: rigid, between: [{{frame: foot, sphere: 0}}, {plane}], friction: 0}}]
"""
    slide = mechanisms.joint("slide", "prismatic", "world", "foot")
    links = mechanisms.link("world", 1.0), mechanisms.link("foot", 1.0)
    scene = scene_of(text, mechanisms.urdf(*links, slide))
    (part,) = scene.constraints
    k, _ = at(scene, part.pair, scene.initial)
    assert part.pair.gaps(k) == pytest.approx(2.0, abs=1e-14)


BULKS = {  # two bodies, at the centres of `box` and of `wedge`
    "boxes as bodies with faces": ("box_of", "box_of"),
    "a hull over a box": ("hull", "box_of"),
    "a hull over a hull": ("hull", "hull"),
    "a capsule over a box": ("line_of", "box_of"),
    "a box over a capsule": ("box_of", "line_of"),
    "a capsule over a capsule": ("line_of", "line_of"),
    "a hull over a capsule": ("hull", "line_of"),
}


def polyhedra(case):
    rng, made = np.random.default_rng(8), []
    for kind, sides in zip(BULKS[case], ((0.2, 0.3, 0.4), (1.0, 1.0, 1.0)), strict=True):
        if kind == "box_of":
            made.append(box_of(np.array(sides)))
        elif kind == "line_of":
            made.append(line_of(0.05, sides[2]))
        else:
            points = rng.normal(size=(14, 3))
            points *= np.array(sides) / 2.0 / np.linalg.norm(points, axis=1)[:, None]
            made.append(polyhedron(points, ConvexHull(points).simplices))
    return made


def bulks(case):
    a, b = polyhedra(case)
    scene, _, *_ = boxes()
    robot = scene.robot
    sides = [
        Side(name, (Mesh(robot.point(name), body),)) for name, body in (("box", a), ("wedge", b))
    ]
    return scene, contact_pair(robot, Between(*sides)), a, b


@pytest.mark.parametrize("case", BULKS)
def test_features_of_convex_bodies_know_their_distance(case):
    """Bodies that nearly touch, by vertices, edges and faces of both."""
    scene, pair, a, b = bulks(case)
    rng, h, seen = np.random.default_rng(9), 1e-7, []
    for _ in range(25 if a.faces and b.faces else 10):
        pose = pin.SE3(pin.exp3(rng.normal(size=3) * 2.0), rng.normal(size=3))
        pose = nearing_hulls(a, b, pose, 1e-4)
        k, q = placed(scene, pose)
        gaps = pair.gaps(k)
        near = int(np.argmin(gaps))
        seen.append(near)
        assert gaps[near] == pytest.approx(1e-4, rel=0.02)
        assert pair.clearance(k, gaps) == pytest.approx(1e-4, rel=0.02)
        x = State(0.0, q, rng.normal(size=scene.robot.model.nv))
        k, _ = at(scene, pair, x)
        rows = slice(3 * near, 3 * near + 3)
        rate, drift = (pair.jacobian(k) @ x.v)[rows], pair.drift(k, x)[rows]
        ends = [at(scene, pair, x, shift)[0] for shift in (-h, h)]
        if any(int(np.argmin(pair.gaps(end))) != near for end in ends):
            continue
        slope = (pair.gaps(ends[1])[near] - pair.gaps(ends[0])[near]) / (2 * h)
        rates = [(pair.jacobian(end) @ x.v)[rows] for end in ends]
        assert slope == pytest.approx(rate[0], abs=1e-5)
        bend = (rates[1] - rates[0]) / (2 * h)
        bend[1:] += spin(pair, ends[0], k, ends[1])[near] / (2 * h) * rate[[2, 1]] * (-1.0, 1.0)
        assert bend == pytest.approx(drift, abs=1e-4)
    assert 0 in seen and max(seen) > 0


def nearing_hulls(a, b, pose, distance):
    """As `nearing`: distances are found by planes, or along the line of a capsule."""
    way = pose.translation / np.linalg.norm(pose.translation)
    turned, least = a.vertices @ pose.rotation.T, a.radius + b.radius
    if a.faces and b.faces:
        axes = np.concatenate([b.normals, -(a.normals @ pose.rotation.T), *crosses(turned, a, b)])

    def apart(far):
        moved = turned + far * way
        if a.faces and b.faces:
            return ((moved @ axes.T).min(axis=0) - (b.vertices @ axes.T).max(axis=0)).max()
        if not a.faces:
            return along_line(moved, b) - least
        local = (b.vertices - far * way) @ pose.rotation
        return along_line(local, a) - least

    far, near = 3.0, 0.0
    while far - near > 1e-8:
        middle = 0.5 * (far + near)
        far, near = (middle, near) if apart(middle) > distance else (far, middle)
    return pin.SE3(pose.rotation, far * way)


def along_line(ends, body):
    """Distance of a line to a body; distances of its points are a convex function along it."""
    low, high, distance = 0.0, 1.0, _to_mesh(body, 0.0) if body.faces else None
    for _ in range(5):
        share = np.linspace(low, high, 41)[:, None]
        points = (1.0 - share) * ends[0] + share * ends[1]
        if distance is None:
            points[:, 2] -= np.clip(points[:, 2], *body.vertices[:, 2])
            gaps = np.linalg.norm(points, axis=1)
        else:
            gaps = distance(points)[0]
        best, step = int(np.argmin(gaps)), (high - low) / 40.0
        low, high = max(share[best, 0] - step, 0.0), min(share[best, 0] + step, 1.0)
    return gaps.min()


def crosses(turned, a, b):
    """Directions across every edge of one body and every edge of another, both ways."""
    edges = [
        np.concatenate([np.roll(points[f], -1, axis=0) - points[f] for f in body.faces])
        for points, body in ((turned, a), (b.vertices, b))
    ]
    across = np.cross(edges[0][:, None], edges[1][None]).reshape(-1, 3)
    length = np.linalg.norm(across, axis=1)
    across = across[length > 1e-6] / length[length > 1e-6, None]
    return across, -across


def test_a_mesh_stands_on_a_box_at_the_corners_of_what_they_share():
    """A cube as a mesh, with four corners, half of it beside the box."""
    scene, _, _, b = boxes()
    cube = box_of(np.array((0.2, 0.2, 0.2)))
    sides = (
        Side("box", (Mesh(scene.robot.point("box"), cube),)),
        Side("wedge", (Box(scene.robot.point("wedge"), b),)),
    )
    pair = contact_pair(scene.robot, Between(*sides))
    k, _ = placed(scene, pin.SE3(np.eye(3), np.array((0.5, 0.1, 0.6))))
    gaps, places = pair.gaps(k), pair.places(k)
    assert gaps[0] > 0.01 and gaps[1:] == pytest.approx(np.zeros(4), abs=1e-12)
    corners = places.point[1:, :2]
    assert ConvexHull(corners).volume == pytest.approx(0.1 * 0.2, abs=1e-12)
    assert places.axes[1:, :, 2] == pytest.approx(np.tile((0, 0, 1.0), (4, 1)), abs=1e-12)


@pytest.mark.parametrize("sides", [(0.2, 0.3, 0.4), (1.0, 0.1, 0.5)])
def test_a_mesh_of_a_box_is_the_box_for_balls(sides):
    """Random places inside and outside, one by one; both are signed distances of their own."""
    rng, sides = np.random.default_rng(10), np.array(sides)
    mesh, box = _to_mesh(box_of(sides), 1e-6), _to_box(sides / 2.0)
    for centre in rng.uniform(-1.0, 1.0, (300, 3)) * sides:
        gaps, normals = zip(mesh(centre[None]), box(centre[None]), strict=True)
        assert gaps[0] == pytest.approx(gaps[1], abs=1e-12)
        assert normals[0] == pytest.approx(normals[1], abs=1e-9)


@pytest.mark.parametrize("as_mesh", [False, True])
def test_a_box_that_slides_along_the_edges_of_another_stands_on_all_that_they_share(as_mesh):
    """Equal boxes, one pushed along x: vertices of b stand on edges of a, to the bit."""
    text = "bodies: {lower: {shape: {box: [0.2, 0.2, 0.2]}, mass: 1}, upper: {shape: {box: [0.2, "
    scene = scene_of(text + "0.2, 0.2]}, mass: 1}}\n")
    robot, sides = scene.robot, np.full(3, 0.2)
    shapes = [
        Mesh(robot.point(name), box_of(sides)) if as_mesh else Box(robot.point(name), sides)
        for name in ("upper", "lower")
    ]
    a, b = (Side(shape.at.frame, (shape,)) for shape in shapes)
    pair, k, q = contact_pair(robot, Between(a, b)), Kinematics(robot), robot.neutral()
    at_upper = next(base.q.start for base in robot.bases if base.name == "upper")
    for way in (0.0, 1e-9, 0.02, 0.1, 0.19):
        q[at_upper : at_upper + 3] = (way, 0.0, 0.2)
        k.refresh(q, np.zeros(robot.model.nv))
        touching = np.abs(pair.gaps(k)) < 2e-9
        points = pair.places(k).point[touching, :2]
        assert len(points) == 4
        assert ConvexHull(points).volume == pytest.approx(0.2 * (0.2 - way), abs=1e-9)


FREE = [case for case, (a, b, _) in {**SMOOTH, **OTHERS}.items() if "ground" not in (a, b)]


@pytest.mark.parametrize("case", FREE)
def test_free_bodies_see_one_another_wherever_they_are(case):
    """Both moved and turned alike, 100 m away: the same gaps, rates and drift in frames of b."""
    a, b, _ = {**SMOOTH, **OTHERS}[case]
    scene, pair = pair_of(a, b)
    whole = pin.SE3(pin.exp3(np.array((0.4, -1.1, 2.0))), np.array((100.0, -60.0, 30.0)))
    for x in random_states(scene, 3, seed=3):
        q = x.q.copy()
        for base in scene.robot.bases:
            q[base.q] = pin.SE3ToXYZQUAT(whole * pin.XYZQUATToSE3(q[base.q]))
        values = []
        for state in (x, x._replace(q=q)):
            k, state = at(scene, pair, state)
            values.append((pair.gaps(k), pair.jacobian(k) @ x.v, pair.drift(k, state)))
        for here, there in zip(*values, strict=True):
            assert there == pytest.approx(here, abs=1e-10 * (1.0 + np.abs(here).max()))


@pytest.mark.parametrize("scale", [1e-3, 1e3])
@pytest.mark.parametrize("shape", ["box", "mesh", "capsule"])
def test_sizes_change_nothing_but_lengths(shape, scale):
    """A body over a box of any size, all lengths scaled: the same features, scaled gaps."""
    robot = pair_of("box", "ground")[0].robot
    rng = np.random.default_rng(11)

    def made(size):
        a, b = robot.point("box"), robot.point("wedge")
        bodies = {
            "box": Box(a, size * np.array((0.2, 0.3, 0.4))),
            "mesh": Mesh(a, box_of(size * np.array((0.2, 0.3, 0.4)))),
            "capsule": Capsule(a, 0.1 * size, 0.3 * size),
        }
        sides = Side("box", (bodies[shape],)), Side("wedge", (Box(b, np.full(3, size)),))
        return contact_pair(robot, Between(*sides))

    one, other, k = made(1.0), made(scale), Kinematics(robot)
    for _ in range(20):
        turn, place = pin.exp3(rng.normal(size=3)), rng.normal(size=3)
        place *= rng.uniform(0.5, 0.9) / np.linalg.norm(place)
        gaps = []
        for pair, size in ((one, 1.0), (other, scale)):
            q = robot.neutral()
            for base in robot.bases:
                own = pin.SE3(turn, size * place) if base.name == "box" else pin.SE3.Identity()
                q[base.q] = pin.SE3ToXYZQUAT(own)
            k.refresh(q, np.zeros(robot.model.nv))
            gaps.append(pair.gaps(k) / size)
        assert gaps[1] == pytest.approx(gaps[0], abs=1e-9)


def test_no_point_is_inside_an_outline_without_size():
    """Corners of a face of a body that flew apart without end are one number."""
    outline, up = np.full((4, 3), 4e19), np.array((0.0, 0.0, 1.0))
    assert not inside(np.zeros((2, 3)), outline, up, 0.1).any()
