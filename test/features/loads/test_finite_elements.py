"""Meshes with the loads of a body: CalculiX against closed forms, FEBio, ParaView, bad input."""

import random
import re
import resource
import shutil
import subprocess
from xml.etree import ElementTree

import numpy as np
import pytest
from loads import RATE, ROD, spin
from solids import box, cylinder, tube, write_mesh

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import DataError
from mbd_ros.features.loads.fem.finite_elements import MeshTask, body_of, write_body
from mbd_ros.features.loads.fem.mesh import KINDS, mass_of, nodal_forces, read_mesh
from mbd_ros.features.loads.fem.model import centre_field
from mbd_ros.features.loads.history import SYSTEMS
from mbd_ros.features.loads.job import LoadsTask, run_loads
from mbd_ros.files.table import Column, Result, Table
from mbd_ros.motion.samples import Task

pytest.importorskip("meshio")
needs_ccx = pytest.mark.skipif(
    shutil.which("ccx") is None, reason="CalculiX is not installed: apt-get install calculix-ccx"
)
YOUNG, SIDE = 70e9, 0.04
ALONG_X = ("0", "0", "0", "0", repr(np.pi / 2.0), "0")  # z of the mesh is x of the link


def still(name="hinge"):
    t = np.arange(3) * 0.01
    zero = np.zeros(3)
    names = "position", "velocity", "acceleration"
    return Result(
        {"samples": Table([Column("time", t), *(Column(f"{name}.{n}", zero) for n in names)])}
    )


@pytest.fixture
def rod(tmp_path, monkeypatch):
    """A scene of a rod on a hinge with a tip, its motions, and a box that is the rod."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "rod.urdf").write_text(ROD)
    (tmp_path / "rod.yaml").write_text("robot: {urdf: rod.urdf}\n")
    still().to("still.csv")
    spin().to("spin.csv")
    write_mesh(box((SIDE, SIDE, 1.0), (2, 2, 8)), tmp_path / "box.inp", 1.0)
    write_mesh(box((SIDE, SIDE, 1.0), (2, 2, 8)), tmp_path / "box_mm.inp", 1000.0)
    return tmp_path


def loads(motion, out, *more, mesh="box.inp", young="70e9"):
    words = ["loads", "rod.yaml", motion, "--body", "rod", "--joint", "weld", "-o", out]
    mesh_words = ["--mesh", mesh, "--mesh-pose", *ALONG_X, "--young", young, "--poisson", "0.0"]
    return main([*words, *mesh_words, "--attach", "hinge=bottom", "weld=top", *more])


def solved(path, set_of_tip="L_weld"):
    """Reactions at the support and displacements of the tip, of every step."""
    text = path.read_text()
    asked = f"*NODE PRINT,NSET={set_of_tip}\nU\n*END STEP"
    path.write_text(text.replace("*END STEP", asked))
    done = subprocess.run(["ccx", path.stem], cwd=path.parent, capture_output=True)
    assert b"*ERROR" not in done.stdout, done.stdout.decode()
    forces, moved = [], []
    for block in path.with_suffix(".dat").read_text().split("\n\n"):
        rows = [line.split()[1:] for line in block.strip().splitlines()]
        if not rows or not rows[0]:
            continue
        if "forces" in rows[0] or block.strip().startswith("forces"):
            target = forces
        elif block.strip().startswith("displacements"):
            target = moved
        else:
            target.append(np.array(rows, dtype=float))
    return forces, moved


@needs_ccx
@pytest.mark.parametrize("units", ["m", "mm"])
def test_a_cantilever(rod, units):
    """Tip weight and own weight: F L^3 / 3 E I + q L^4 / 8 E I; the hinge holds it."""
    mesh, young = ("box.inp", "70e9") if units == "m" else ("box_mm.inp", "70e3")
    assert loads("still.csv", "bent.inp", "--units", units, mesh=mesh, young=young) == 0
    _, moved = solved(rod / "bent.inp")
    second = SIDE**4 / 12.0
    tip, own = 0.5 * 9.81, 2.0 * 9.81
    expected = tip / (3.0 * YOUNG * second) + own / (8.0 * YOUNG * second)
    sag = -moved[0][:, 2].mean() / (1.0 if units == "m" else 1000.0)
    assert sag == pytest.approx(expected, rel=0.02)


@needs_ccx
def test_a_cantilever_converges(rod):
    """Linear elements, against a beam that shears too: 6 / 5 (F L + q L^2 / 2) / G A."""
    second, area, shear = SIDE**4 / 12.0, SIDE**2, YOUNG / 2.0
    bent = 9.81 * (0.5 / 3.0 + 2.0 / 8.0) / (YOUNG * second)
    expected = bent + 1.2 * 9.81 * (0.5 + 1.0) / (shear * area)
    errors = []
    for count in (2, 4, 8):
        mesh = box((SIDE, SIDE, 1.0), (1, 1, count))
        corners = mesh.blocks[0][1][:, :8]
        write_mesh(mesh._replace(blocks=(("hexahedron", corners),)), rod / "box.inp", 1.0)
        assert loads("still.csv", "bent.inp") == 0
        _, moved = solved(rod / "bent.inp")
        errors.append(abs(-moved[0][:, 2].mean() / expected - 1.0))
    assert errors[2] <= 0.02
    assert errors[2] < 0.5 * errors[1] < 0.25 * errors[0]


@needs_ccx
@pytest.mark.parametrize("coupling", ["rigid", "distributing"])
def test_a_spinning_rod(rod, coupling):
    """Elongation rho omega^2 L^3 / 3 E + m omega^2 L / E A, and the pull at the hinge."""
    assert loads("spin.csv", "spun.inp", "--coupling", coupling) == 0
    _, moved = solved(rod / "spun.inp")
    area = SIDE**2
    density = 2.0 / area
    long = density * RATE**2 / (3.0 * YOUNG) + 0.5 * RATE**2 / (YOUNG * area)
    assert moved[0][:, 0].mean() == pytest.approx(long, rel=0.02)


PYLON = {"knee": "top", "ankle": "bottom"}  # ends of the tube that stands for the shank
STIFF = {"young": 70e3, "poisson": 0.33, "density": 2.7e-9}  # aluminium, units mm


@pytest.fixture(scope="module")
def walk():
    """Loads on the shank of a leg that rolls over its foot."""
    scene = mbd.load_scene("prosthetic_leg_roll_over")
    task = LoadsTask(Task(scene.simulate(0.1)), "shank", at=(0.02, 0.05, 0.08))
    _, history, instants = run_loads(scene, task, lambda text: None)
    return history, [one for one in instants if one.name == "chosen"]


def pylon(history, instants, **other):
    """The tube as finite elements, between ankle and knee."""
    mesh = tube(0.0125, 0.015, 0.36, (1, 12, 6))
    mesh = mesh._replace(points=mesh.points + np.array([0.0, 0.0, -0.40]))
    task = MeshTask(**({"mesh": mesh, "attach": PYLON, **STIFF} | other))
    return body_of(history, instants, task, SYSTEMS["mm"])


@needs_ccx
@pytest.mark.parametrize("coupling", ["rigid", "distributing"])
def test_reactions_of_the_solved_steps_are_the_applied_loads(walk, tmp_path, coupling):
    """Three instants of walking, force and moment; what acts on held nodes themselves is added."""
    body, steps, _ = pylon(*walk, coupling=coupling)
    write_body(body, steps, tmp_path / "pylon.inp", lambda text: None)
    forces, _ = solved(tmp_path / "pylon.inp", "L_ankle")
    assert len(forces) == 3
    held, density = body.fixed, body.material.density
    for step, (force, moment) in zip(steps, forces, strict=True):
        spin = step.spin

        def field(r, spin=spin, step=step):
            return density * (step.gravity - np.cross(spin, np.cross(spin, r)))

        own = nodal_forces(body.mesh.points, body.mesh.blocks, field) + step.turning
        own = own[held.nodes]
        arms = body.mesh.points[held.nodes] - held.reference
        found = np.concatenate((force - own.sum(0), moment / 1e3 - np.cross(arms, own).sum(0)))
        largest = np.abs(step.reaction).max()
        assert found == pytest.approx(step.reaction, abs=1e-6 * largest)
        assert np.linalg.norm(step.known - step.reaction) < 0.5 * np.linalg.norm(step.known)


def test_a_mesh_in_other_units_or_another_place_is_refused(walk):
    tall = tube(12.5, 15.0, 360.0, (1, 8, 4))  # mm taken for m
    tall = tall._replace(points=tall.points + np.array([0.0, 0.0, -400.0]))
    with pytest.raises(DataError, match="a density of .* check --density, or --units"):
        pylon(*walk, mesh=tall, density=None)
    with pytest.raises(DataError, match="accepted: 3 or more; the nearest is"):
        pylon(*walk, mesh=tall, attach={}, radius=20.0)
    thick = tube(0.001, 0.05, 0.36, (1, 8, 4))
    thick = thick._replace(points=thick.points + np.array([0.0, 0.0, -0.4]))
    with pytest.raises(DataError, match="check --units, --mesh-pose and --density"):
        pylon(*walk, mesh=thick, density=2.7e-8)
    turned = tube(0.0125, 0.015, 0.36, (1, 8, 4))
    turned = turned._replace(points=turned.points + np.array([5.0, 0.0, 0.0]))
    with pytest.raises(DataError, match="from load knee; check --units and --mesh-pose"):
        pylon(*walk, mesh=turned)


def test_a_solid_that_nothing_holds(walk):
    """Two tubes, one beyond the other; tied where a load has nodes of both."""
    mesh = tube(0.0125, 0.015, 0.36, (1, 8, 4))
    points = mesh.points + np.array([0.0, 0.0, -0.4])
    (kind, cells), n = mesh.blocks[0], len(points)
    both = ((kind, np.vstack((cells, cells + n))),)
    inner = mesh._replace(points=np.vstack((points, 0.8 * points)), blocks=both)
    with pytest.raises(DataError, match=f"{n} nodes, .* are not connected to the support knee"):
        pylon(*walk, mesh=inner)
    top = np.concatenate((mesh.sets["top"], mesh.sets["top"] + n))
    body, _, _ = pylon(*walk, mesh=inner._replace(sets={**mesh.sets, "top": top}))
    assert len(body.fixed.nodes) == 2 * len(mesh.sets["top"])


@pytest.mark.parametrize(
    ("other", "says"),
    [
        ({"attach": {"knee": "lid", "ankle": "bottom"}}, "no such set; sets of tube: bottom, top"),
        ({"attach": {"hip": "top"}}, "--attach hip: no such load; accepted: knee, ankle"),
        ({"attach": {"knee": "top"}}, "load ankle has no nodes: --attach ankle=SET"),
        ({"attach": {"knee": "top", "ankle": "top"}}, "share .* nodes"),
        ({"support": "hip"}, "--support hip: no such load; accepted: knee, ankle"),
        ({"young": -1.0}, "--young"),
        ({"poisson": 0.5}, "--poisson 0.5: accepted"),
        ({"coupling": "glue"}, "--coupling glue: accepted: rigid, distributing"),
        ({"attach": {"knee": "-3", "ankle": "bottom"}}, "accepted: > 0"),
    ],
)
def test_bad_words_for_a_mesh(walk, other, says):
    with pytest.raises(DataError, match=says):
        pylon(*walk, **other)


def test_febio(walk, tmp_path):
    """Names that are referred to exist; curves are the loads."""
    body, steps, _ = pylon(*walk)
    write_body(body, steps, tmp_path / "pylon.feb", lambda text: None)
    root = ElementTree.parse(tmp_path / "pylon.feb").getroot()
    assert root.tag == "febio_spec" and root.get("version") == "4.0"
    rooms = [child.tag for child in root]
    assert rooms[:5] == ["Module", "Control", "Material", "Mesh", "MeshDomains"]
    materials = {one.get("name") for one in root.iter("material")}
    sets = {one.get("name") for one in root.iter("NodeSet")}
    domains = {one.get("name") for one in root.iter("Elements")}
    assert {one.text for one in root.iter("rb")} <= materials
    assert {one.get("node_set") for one in root.iter("bc")} == sets == {"knee", "ankle"}
    for one in root.iter("SolidDomain"):
        assert one.get("name") in domains and one.get("mat") in materials
    nodes = len(list(root.iter("node")))
    used = [int(n) for one in root.iter("elem") for n in one.text.split(",")]
    assert min(used) == 1 and max(used) == nodes
    curves = {
        one.get("id"): [float(p.text.split(",")[1]) for p in one.iter("pt")]
        for one in root.iter("load_controller")
    }
    (pull,) = (one for one in root.iter("rigid_load") if one.find("dof").text == "Rz")
    expected = [0.0, *(step.forces[0, 2] for step in steps)]
    assert curves[pull.find("value").get("lc")] == pytest.approx(expected)
    z = next(root.iter("body_load")).find("z")
    assert curves[z.get("lc")][1] == pytest.approx(-1000.0 * steps[0].gravity[2], rel=0.5)


def test_febio_as_pyfebio_reads_it(walk, tmp_path):
    """A model of the specification by others; its reader takes no 1 for a fixed direction."""
    model = pytest.importorskip("pyfebio.model", reason="pyfebio is not installed")
    body, steps, _ = pylon(*walk)
    write_body(body, steps, tmp_path / "pylon.feb", lambda text: None)
    text = re.sub(r"<(R._dof)>1</\1>", "", (tmp_path / "pylon.feb").read_text())
    read = model.Model.from_xml(text.encode())
    assert len(read.rigid_.all_rigid_loads) == 6


def test_a_series_for_paraview(walk, tmp_path):
    import meshio

    body, steps, _ = pylon(*walk)
    (tmp_path / "other").write_text("precious", encoding="utf-8")
    (tmp_path / "pylon_0000.vtu").symlink_to("other")  # is replaced
    write_body(body, steps, tmp_path / "pylon.vtu", lambda text: None)
    assert (tmp_path / "other").read_text(encoding="utf-8") == "precious"
    listed = ElementTree.parse(tmp_path / "pylon.pvd").getroot()
    files = [(float(e.get("timestep")), e.get("file")) for e in listed.iter("DataSet")]
    assert [time for time, _ in files] == pytest.approx([0.02, 0.05, 0.08])
    read = meshio.read(tmp_path / files[1][1])
    assert len(read.points) == len(body.mesh.points) + 1
    assert read.points[-1] == pytest.approx(1000.0 * body.loaded[0].reference)
    assert read.point_data["force"][-1] == pytest.approx(steps[1].forces[0])


@pytest.mark.parametrize("kind", KINDS)
def test_mass_and_forces_of_elements(kind):
    """One element of each kind, sheared: volume, and the force of a linear field."""
    box_of_one = box((1.0, 1.0, 1.0), (1, 1, 1))
    shear = np.array([[1.0, 0.2, 0.0], [0.0, 1.3, 0.1], [0.3, 0.0, 0.8]])
    if kind.startswith("hexa"):
        points, volume = box_of_one.points @ shear.T, np.linalg.det(shear)
        count = 8 if kind == "hexahedron" else 20
        cells = box_of_one.blocks[0][1][:, :count]
        centre = np.array([0.0, 0.0, 0.5]) @ shear.T
    else:
        corners = np.vstack((np.zeros(3), np.eye(3)))
        middles = [(corners[a] + corners[b]) / 2.0 for a, b in KINDS["tetra10"].edges]
        points = np.vstack((corners, middles)) @ shear.T
        volume, centre = np.linalg.det(shear) / 6.0, np.full(3, 0.25) @ shear.T
        cells = np.arange(4 if kind == "tetra" else 10).reshape(1, -1)
    blocks = [(kind, cells)]
    mass = mass_of(points, blocks)
    assert mass.volume == pytest.approx(volume, rel=1e-12)
    assert mass.centre == pytest.approx(centre, abs=1e-12)
    slope = np.arange(9.0).reshape(3, 3)
    forces = nodal_forces(points, blocks, lambda r: r @ slope.T + 1.0)
    assert forces.sum(axis=0) == pytest.approx(volume * (slope @ centre + 1.0), rel=1e-12)


def test_a_cylinder():
    mass = mass_of((mesh := cylinder(0.1, 0.5, (6, 4))).points, mesh.blocks)
    assert mass.volume == pytest.approx(np.pi * 0.01 * 0.5, rel=1e-3)
    assert mass.inertia[2, 2] == pytest.approx(0.5 * mass.volume * 0.01, rel=1e-3)


def test_meshes_that_cannot_be_read(tmp_path):
    import meshio

    with pytest.raises(DataError, match="No such file"):
        read_mesh(tmp_path / "none.msh", 1.0)
    (tmp_path / "text.msh").write_text("nothing")
    with pytest.raises(DataError, match="cannot be read"):
        read_mesh(tmp_path / "text.msh", 1.0)
    flat = meshio.Mesh(np.eye(3), [("triangle", [[0, 1, 2]])])
    flat.write(tmp_path / "flat.vtu")
    with pytest.raises(DataError, match="has triangle; accepted solids: tetra"):
        read_mesh(tmp_path / "flat.vtu", 1.0)
    mesh = box((1.0, 1.0, 1.0), (1, 1, 1))
    inside_out = mesh._replace(points=mesh.points * [1.0, 1.0, -1.0])
    write_mesh(inside_out, tmp_path / "inverted.vtu", 1.0)
    with pytest.raises(DataError, match="turned inside out"):
        read_mesh(tmp_path / "inverted.vtu", 1.0)


def broken(data, rng):
    """A file with numbers, bytes or lines changed, or cut."""
    if rng.random() < 0.1:
        return data[: rng.randrange(len(data))]
    data = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 5))):
        begin = rng.randrange(len(data))
        number = re.search(rb"-?\d+", bytes(data[begin:]))
        if number and rng.random() < 0.5:
            new = rng.choice((b"-1", b"", b"300000000", b"99999999999999999999", b"nan", b"x"))
            data[begin + number.start() : begin + number.end()] = new
        else:
            new = rng.choice((b"\xff", b"\0\0\0\0", b"\n", rng.randbytes(2), b"\xff\xff\xff\x7f"))
            data[begin : begin + rng.choice((0, len(new)))] = new
    return bytes(data)


@pytest.mark.parametrize("suffix", [".vtk", ".vtu", ".msh", ".inp", ".mesh", ".bdf", ".su2"])
def test_broken_meshes_are_refused_by_name(tmp_path, suffix, capfd):
    import meshio

    mesh = box((1.0, 1.0, 1.0), (1, 1, 1))
    file, rng, read = tmp_path / f"mesh{suffix}", random.Random(f"49 {suffix}"), 0
    linear = meshio.Mesh(mesh.points, [("hexahedron", mesh.blocks[0][1][:, :8])])
    linear.write(file, file_format="gmsh22" if suffix == ".msh" else None)
    whole = file.read_bytes()
    for _ in range(60):
        file.write_bytes(broken(whole, rng))
        try:
            read_mesh(file, 1.0)
            read += 1
        except DataError as error:
            assert str(file) in str(error)
    assert read


@pytest.mark.parametrize("suffix", [".mdpa", ".tec", ".vol", ".off", ".ply"])
def test_formats_whose_readers_may_not_end_are_refused(tmp_path, suffix):
    """The reader of a cut file of Kratos went on for ever."""
    (tmp_path / f"cut{suffix}").write_text("Begin Nodes\n")
    with pytest.raises(DataError, match=r"unknown format, accepted: .vtk, .vtu, .msh, .inp"):
        read_mesh(tmp_path / f"cut{suffix}", 1.0)


GRID = """# vtk DataFile Version 4.2
grid
ASCII
DATASET STRUCTURED_POINTS
DIMENSIONS 2000 2000 2000
ORIGIN 0 0 0
SPACING 1 1 1
"""
FAR_NODE = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
2
1 0 0 0
2000000000 1 0 0
$EndNodes
$Elements
1
1 4 2 1 1 1 1 1 1
$EndElements
"""


@pytest.mark.parametrize(("name", "text"), [("grid.vtk", GRID), ("far.msh", FAR_NODE)])
def test_numbers_in_a_mesh_take_no_memory(tmp_path, name, text):
    """8e9 cells, and an array as long as the largest number of a node: 8 GB and more."""
    (tmp_path / name).write_text(text)
    limits = resource.getrlimit(resource.RLIMIT_AS)
    with pytest.raises(DataError, match=f"{name}: cannot be read .Unable to allocate"):
        read_mesh(tmp_path / name, 1.0)
    assert resource.getrlimit(resource.RLIMIT_AS) == limits


def test_cells_of_nodes_that_are_not_there_are_named(tmp_path):
    import meshio

    points = np.vstack((np.zeros(3), np.eye(3)))
    for nodes, words in (([0, 1, 2, 4], "0 .. 4"), ([-1, 1, 2, 3], "-1 .. 3")):
        meshio.Mesh(points, [("tetra", [nodes])]).write(tmp_path / "far.vtu", binary=False)
        with pytest.raises(DataError, match=f"its tetra: nodes {words}, there are 0 .. 3"):
            read_mesh(tmp_path / "far.vtu", 1.0)


def test_bad_input_of_the_command(rod, capsys):
    assert main(["loads", "rod.yaml", "still.csv", "--body", "rod", "-o", "a.inp"]) == 2
    assert "--mesh is missing" in capsys.readouterr().err
    words = ["loads", "rod.yaml", "still.csv", "--body", "rod", "-o", "a.inp", "--mesh", "box.inp"]
    assert main(words) == 2
    assert "--mesh goes with --young" in capsys.readouterr().err
    assert loads("still.csv", "a.inp", "--support", "nobody") == 2
    assert "accepted: hinge, weld" in capsys.readouterr().err
    assert not (rod / "a.inp").exists()


@needs_ccx
def test_amplitudes(walk, tmp_path):
    """Along the motion: support, loads, gravity and inertia add up to zero."""
    history, instants = walk
    first = {name: getattr(history, name)[:12] for name in ("stamps", "point", "force", "moment")}
    motion = history.motion._make(values[:12] for values in history.motion)
    mesh = tube(0.0125, 0.015, 0.36, (1, 6, 2))
    mesh = mesh._replace(points=mesh.points + np.array([0.0, 0.0, -0.40]))
    history = history._replace(**first, motion=motion)
    body, steps, _ = pylon(history, instants[:1], mesh=mesh)
    said = []
    write_body(body, steps, tmp_path / "pylon.inp", said.append, amplitudes=True)
    assert "left out of pylon.inp: inertia by rotation" in said[0]
    forces, _ = solved(tmp_path / "pylon.inp", "L_ankle")
    assert len(forces) == len(body.history.stamps) - 1
    density, field = body.material.density, centre_field(body)
    for row in (1, 11):
        gravity = nodal_forces(
            body.mesh.points, body.mesh.blocks, lambda r, row=row: density * field[row] + 0.0 * r
        )
        held = gravity[body.fixed.nodes].sum(axis=0)
        ankle = body.history.force[row, body.loaded[0].slot]
        expected = -ankle - gravity.sum(axis=0)
        assert forces[row - 1][0] - held == pytest.approx(expected, abs=1e-5 * np.abs(ankle).max())
    with pytest.raises(DataError, match="--amplitudes goes with .inp"):
        write_body(body, steps, tmp_path / "pylon.feb", said.append, amplitudes=True)
