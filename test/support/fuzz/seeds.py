"""Sound cases of formats and models: small files, and commands that read them within milliseconds.

`task_seeds` has those of tasks. A seed says which of its files are mutated; what it reads follows
from its words and files.
"""

import gzip
import json
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import muscle_arm
import numpy as np
import osim_models
from fuzz import urdf
from places import ROOT

from mbd_ros.files.formats import STORAGES
from mbd_ros.files.table import Column, Result, Table

JOINTS = ("j1", "j2")
TIMES = np.arange(1, 9) * 0.01
MARKERS = {
    "A": ("l1", [0.1, 0.0, 0.1]),
    "B": ("l2", [0.0, 0.1, 0.1]),
    "C": ("l2", [0.1, 0.1, 0.2]),
}


class Seed(NamedTuple):
    """A case that ends with exit code 0.

    Attributes:
        words: Of the command; @ stands for the folder of the files.
        files: Contents by name.
        mutated: Names of the files that become hostile.
        out: Name of the result, with a slash behind it for a folder; empty without one.
        behind: Message of a command that has read its files and then lacks an optional package.
    """

    words: tuple[str, ...]
    files: Mapping[str, bytes]
    mutated: tuple[str, ...]
    out: str = "o.csv"
    behind: str = ""


def of_values(**sections: Any) -> bytes:
    """A scene or task; JSON is YAML."""
    return json.dumps(sections).encode()


def written(result: Result, name: str) -> dict[str, bytes]:
    """The files that a result becomes, by name."""
    with TemporaryDirectory() as folder:
        place = Path(folder) / name
        result.to(place)
        files = [place] if place.is_file() else sorted(place.iterdir())
        return {str(file.relative_to(folder)): file.read_bytes() for file in files}


def table(result: Result) -> bytes:
    return written(result, "m.csv")["m.csv"]


def swing(joints: tuple[str, ...] = JOINTS, rows: int = 8) -> Result:
    """A motion of joints with all derivatives, and efforts."""
    time = np.arange(1, rows + 1) * 0.01
    columns = [Column("time", time, "s")]
    for i, joint in enumerate(joints):
        rate = 9.0 + 2.0 * i
        curves = {
            "position": 0.5 * np.sin(rate * time),
            "velocity": 0.5 * rate * np.cos(rate * time),
            "acceleration": -0.5 * rate**2 * np.sin(rate * time),
            "effort": 3.0 * np.cos(rate * time + i),
        }
        columns += [Column(f"{joint}.{field}", values) for field, values in curves.items()]
    return Result({"samples": Table(columns)})


def two_joints(**sections: Any) -> dict[str, bytes]:
    """A scene of two joints, with its description."""
    scene = of_values(robot={"urdf": "r.urdf"}, **sections)
    return {"s.yaml": scene, "r.urdf": urdf.two_joints().encode()}


def marked() -> dict[str, bytes]:
    """The same with three markers."""
    sensors = {
        name: {"type": "marker", "frame": frame, "xyz": xyz}
        for name, (frame, xyz) in MARKERS.items()
    }
    return two_joints(sensors=sensors)


def muscled() -> dict[str, bytes]:
    """An arm with six muscles."""
    scene = of_values(robot={"urdf": "r.urdf"}, **muscle_arm.SCENE)
    return {"s.yaml": scene, "r.urdf": muscle_arm.URDF.encode()}


def capture(rows: int = 4) -> Result:
    """Three markers in motion."""
    places = {"A": (0.1, 0.1, 0.4), "B": (0.0, 0.3, 0.7), "C": (0.1, 0.3, 0.8)}
    drift = 0.01 * np.arange(rows)[:, None]
    columns = [Column(name, np.array(at) + drift, "m", "ground") for name, at in places.items()]
    time = Column("time", np.arange(rows) / 100.0, "s")
    return Result({"samples": Table([time, *columns])}, {"markers": [*places], "rate": 100.0})


def c3d() -> bytes:
    """The same as a recording of motion capture."""
    import ezc3d  # here, since tests without it are skipped

    recording, samples = ezc3d.c3d(), capture()["samples"]
    points = recording["parameters"]["POINT"]
    points["LABELS"]["value"], points["UNITS"]["value"] = [*MARKERS], ["m"]
    points["RATE"]["value"] = [100.0]
    places = np.array([samples[label].T for label in MARKERS]).swapaxes(0, 1)
    recording["data"]["points"] = np.concatenate([places, np.ones((1, *places.shape[1:]))])
    with TemporaryDirectory() as folder:
        file = Path(folder) / "m.c3d"
        recording.write(str(file))
        return file.read_bytes()


def storage(columns: Mapping[str, np.ndarray], degrees: str = "yes") -> bytes:
    """A file of OpenSim."""
    names = ["time", *columns]
    head = f"m\nversion=1\nnRows={len(TIMES)}\nnColumns={len(names)}\ninDegrees={degrees}\n"
    rows = [
        "\t".join(map(repr, row)) for row in np.column_stack([TIMES, *columns.values()]).tolist()
    ]
    return "\n".join([f"{head}endheader", "\t".join(names), *rows, ""]).encode()


def format_seeds(suffix: str) -> tuple[Seed, ...]:
    """Sound files of a format, and commands that read them."""
    name = f"m{suffix}"
    if suffix in STORAGES:
        text = storage({"j1": 100.0 * TIMES, "j2": -200.0 * TIMES})
        files = {name: gzip.compress(text) if suffix.endswith(".gz") else text}
        words = "inverse", "@s.yaml", f"@{name}", "--derivatives", "zero-phase", "-o", "@o.csv"
        return (Seed(words, {**two_joints(), **files}, (name,)),)
    if suffix in (".trc", ".trc.gz", ".c3d"):
        files = {name: c3d()} if suffix == ".c3d" else written(capture(), name)
        words = "kinematics", "@s.yaml", f"@{name}", "-o", "@o.csv"
        return (Seed(words, {**marked(), **files}, (name,)),)
    files = written(swing(), name)
    inverse = "inverse", "@s.yaml", f"@{name}", "--derivatives", "causal", "-o", "@o.csv"
    start = (
        "simulate",
        "@s.yaml",
        "-t",
        "0.002",
        "--start",
        "0.02",
        "--from",
        f"@{name}",
        "-o",
        "@o.csv",
    )
    both = {**two_joints(), **files}
    return tuple(Seed(words, both, tuple(files)) for words in (inverse, start))


def _muscled_osim() -> bytes:
    points = "".join(
        f'<PathPoint name="p{i}"><socket_parent_frame>/bodyset/{frame}</socket_parent_frame>'
        f"<location>{at}</location></PathPoint>"
        for i, (frame, at) in enumerate((("a", "0.1 0.2 0"), ("b", "0.1 0.3 0")))
    )
    path = f"<GeometryPath><PathPointSet><objects>{points}</objects></PathPointSet></GeometryPath>"
    muscle = (
        f'<Thelen2003Muscle name="m">{path}<max_isometric_force>500</max_isometric_force>'
        "<optimal_fiber_length>0.2</optimal_fiber_length><tendon_slack_length>0.3"
        "</tendon_slack_length><pennation_angle_at_optimal>0.1</pennation_angle_at_optimal>"
        "</Thelen2003Muscle>"
    )
    marker = (
        '<Marker name="k"><socket_parent_frame>/bodyset/c</socket_parent_frame>'
        "<location>0 0.1 0</location></Marker>"
    )
    coupled = osim_models.coupler("q3", "q2", osim_models.SIMM)
    sets = {"ForceSet": muscle, "MarkerSet": marker, "ConstraintSet": coupled}
    ranged = "<range>-1 1.5</range><default_value>0.2</default_value>"
    return osim_models.chain(locked=ranged, **sets).encode()


MJCF = b"""<mujoco model="m"><compiler angle="degree"/><option gravity="0 0 -9.8"/>
<default><geom density="700"/><default class="a"><joint axis="1 0 0" range="-30 40"/></default>
</default>
<asset><mesh name="cube" file="cube.stl" scale="1 1 2"/></asset>
<worldbody><geom name="floor" type="plane" size="1 1 1"/>
<body name="u" pos="0 0 1" childclass="a">
<joint name="u" damping="0.2" stiffness="3" springref="10"/>
<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02"/>
<geom name="ball" type="sphere" size="0.03"/>
<site name="near" pos="0.1 0 0.06"/>
<body name="l" pos="0.4 0 0" euler="0 20 0"><joint name="l" axis="0 1 0" armature="0.1"/>
<geom type="box" size="0.1 0.02 0.03"/><site name="far" pos="0.3 0 0.05"/>
<body name="w" pos="0.4 0 0"><joint name="w" axis="0 1 0"/><geom type="mesh" mesh="cube"/>
</body></body></body></worldbody>
<tendon><spatial name="t"><site site="near"/><geom geom="ball"/><site site="far"/></spatial>
</tendon>
<equality><joint joint1="w" joint2="l" polycoef="0.1 0.5 0 0 0"/></equality>
<actuator><motor joint="u" gear="2"/></actuator></mujoco>
"""
_CUBE = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.1, 0.1) for z in (0.0, 0.1)])
_SIDES = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))


def cube(suffix: str) -> bytes:
    """A box as .obj, or as binary or textual .stl (`.ascii.stl`)."""
    if suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in _CUBE.tolist()]
        return "\n".join(
            [*lines, *(f"f {a + 1} {b + 1} {c + 1} {d + 1}" for a, b, c, d in _SIDES)]
        ).encode()
    triangles = [_CUBE[[a, *pair]] for a, *rest in _SIDES for pair in (rest[:2], rest[1:])]
    if suffix == ".stl":
        kind = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("more", "<u2")])
        facets = np.zeros(len(triangles), kind)
        facets["corners"] = triangles
        return bytes(80) + np.uint32(len(triangles)).tobytes() + facets.tobytes()
    facets = [
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in corners.tolist())
        + "endloop\nendfacet\n"
        for corners in triangles
    ]
    return f"solid cube\n{''.join(facets)}endsolid cube\n".encode()


def importer_seeds(form: str) -> tuple[Seed, ...]:
    """Models of a program, as they are imported and as they are scenes."""
    if form == "osim":
        bare = osim_models.chain(ConstraintSet=osim_models.COUPLERS).encode()
        command, others = "import-opensim", {}
        models = {
            "m.osim": bare,
            "n.osim": _muscled_osim(),
            "n.osim.gz": gzip.compress(_muscled_osim()),
        }
    else:
        command, others, models = "import-mjcf", {"cube.stl": cube(".stl")}, {"m.xml": MJCF}
    return tuple(
        Seed(words, {name: text, **others}, (name,), out)
        for name, text in models.items()
        for words, out in (((command, f"@{name}", "-o", "@o"), "o/"), (("check", f"@{name}"), ""))
    )


_CONTACT = {"type": "rigid", "friction": 0.5, "name": "c"}


def _touching(file: str) -> dict[str, Any]:
    return {
        "contacts": [
            _CONTACT
            | {"between": [{"frame": "l2", "mesh": {"file": file}}, {"half_space": [0, 0, 1]}]}
        ]
    }


WATER = {
    "atoms": {
        "O": {"mass": 16.0, "at": [0.0, 0.0, 0.0], "charge": -0.8, "sigma": 3.1, "epsilon": 65.0},
        "H": {"mass": 1.0, "at": [0.6, 0.8, 0.0], "charge": 0.8},
    },
    "bonds": [{"between": ["O", "H"], "length": 1.0}],
    "count": 2,
}
_POSITIONS = {
    ".gro": "water\n 4\n"
    + "".join(
        f"{i // 2 + 1:5d}SOL  {'OH'[i % 2]:>5}{i + 1:5d}{x:8.3f}{y:8.3f}{0.1:8.3f}\n"
        for i, (x, y) in enumerate(((0.1, 0.1), (0.16, 0.18), (0.6, 0.6), (0.66, 0.68)))
    )
    + "   1.2   1.2   1.2\n",
    ".xyz": "4\nwater\nO 1 1 1\nH 1.6 1.8 1\nO 6 6 1\nH 6.6 6.8 1\n",
    ".pdb": "".join(
        f"ATOM  {i:5d}  {n:3} HOH A{i:4d}    {x:8.3f}{y:8.3f}{1.0:8.3f}\n"
        for i, (n, x, y) in enumerate((("O", 1, 1), ("H", 1.6, 1.8), ("O", 6, 6), ("H", 6.6, 6.8)))
    ),
}


def particle_seeds() -> tuple[Seed, ...]:
    """Scenes of particles, and files of positions."""
    seeds = []
    for suffix, text in _POSITIONS.items():
        water = WATER | {"placement": {"file": f"p{suffix}"}}
        scene = of_values(
            units="molecular",
            particles={"molecules": {"water": water}, "box": [12.0] * 3, "pairs": {"cutoff": 5.0}},
            initial={"temperature": 300.0, "seed": 1},
            dt=1e-3,
        )
        words = "simulate", "@s.yaml", "-t", "0.003", "-o", "@o.csv"
        files = {"s.yaml": scene, f"p{suffix}": text.encode()}
        seeds.append(Seed(words, files, (f"p{suffix}", "s.yaml")))
    return tuple(seeds)


def mesh_seeds() -> tuple[Seed, ...]:
    """Meshes of contacts."""
    return tuple(
        Seed(
            ("check", "@s.yaml"),
            {**two_joints(**_touching(f"c{suffix}")), f"c{suffix}": cube(suffix)},
            (f"c{suffix}",),
            "",
        )
        for suffix in (".obj", ".stl", ".ascii.stl")
    )


def learned_seeds() -> tuple[Seed, ...]:
    """The embedded model beside the leg that it was learned on."""
    model = (ROOT / "config" / "learned" / "prosthetic_leg.onnx").read_bytes()
    leg = (ROOT / "config" / "scenes" / "prosthetic_leg.yaml").read_bytes()
    scene = leg.replace(b"../robots", b"package://mbd_ros/config/robots")
    scene += b"\nforces: [{type: learned_torque, model: m.onnx}]\n"
    words = "simulate", "@s.yaml", "-t", "0.002", "-o", "@o.csv"
    return (Seed(words, {"s.yaml": scene, "m.onnx": model}, ("m.onnx",)),)


def parameter_seeds() -> tuple[Seed, ...]:
    """Parameters of a node, as it checks them before it starts."""
    given = {"/**": {"ros__parameters": {"scene": "s.yaml", "rate": 100.0, "gains": [1.0, 2.0]}}}
    return (
        Seed(("params-file", "@p.yaml"), {"p.yaml": json.dumps(given).encode()}, ("p.yaml",), ""),
    )
