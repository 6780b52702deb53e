"""Sound cases of commands that read tasks, tables or files of their own."""

import json
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from functools import cache
from io import BytesIO, StringIO
from pathlib import Path
from tempfile import TemporaryDirectory
from types import MappingProxyType
from typing import Any

import muscle_arm
import numpy as np
import solids
from fuzz.seeds import (
    JOINTS,
    TIMES,
    Seed,
    capture,
    marked,
    muscled,
    of_values,
    storage,
    swing,
    table,
    two_joints,
    written,
)

from mbd_ros import cli
from mbd_ros.features.identification.learn.training_samples import Scales
from mbd_ros.files.table import Column, Result, Table

_RAIL = """<robot name='r'><link name='ground'/><link name='mass'><inertial><origin xyz='0 0 0'/>
<mass value='1'/><inertia ixx='1' iyy='1' izz='1' ixy='0' ixz='0' iyz='0'/></inertial></link>
<joint name='slide' type='prismatic'><parent link='ground'/><child link='mass'/><axis xyz='1 0 0'/>
<limit lower='-100' upper='100' effort='0' velocity='0'/></joint></robot>"""
_LOADS = """<OpenSimDocument Version="40000"><ExternalLoads name="grf"><objects>
<ExternalForce name="push"><applied_to_body>{body}</applied_to_body>
<force_expressed_in_body>ground</force_expressed_in_body>
<point_expressed_in_body>ground</point_expressed_in_body>
<force_identifier>plate_v</force_identifier><point_identifier>plate_p</point_identifier>
<torque_identifier>plate_m</torque_identifier><data_source_name>Unassigned</data_source_name>
</ExternalForce></objects><datafile>plate.mot</datafile></ExternalLoads></OpenSimDocument>"""
_RESERVES = """<OpenSimDocument Version="40000"><ForceSet name="reserves"><objects>
<CoordinateActuator name="s"><coordinate>shoulder</coordinate><optimal_force>100</optimal_force>
<min_control>-Inf</min_control><max_control>2</max_control></CoordinateActuator>
<CoordinateActuator name="e"><coordinate>elbow</coordinate><optimal_force>100</optimal_force>
</CoordinateActuator></objects></ForceSet></OpenSimDocument>"""
_SETUP = """<OpenSimDocument Version="40000"><InverseKinematicsTool><IKTaskSet><objects>
<IKMarkerTask name="A"><apply>true</apply><weight>2</weight></IKMarkerTask>
<IKMarkerTask name="B"><apply>true</apply><weight>1</weight></IKMarkerTask>
<IKCoordinateTask name="j1"><apply>true</apply><weight>0.5</weight>
<value_type>manual_value</value_type><value>0.1</value></IKCoordinateTask>
<IKCoordinateTask name="j2"><weight>0.1</weight><value_type>from_file</value_type>
</IKCoordinateTask></objects></IKTaskSet><coordinate_file>m.csv</coordinate_file>
<time_range>0.005 0.03</time_range></InverseKinematicsTool></OpenSimDocument>"""


def _external(body: str) -> dict[str, bytes]:
    columns = {
        f"plate_{kind}{axis}": 0.1 * np.cos(TIMES + i)
        for i, (kind, axis) in enumerate((k, a) for k in "vpm" for a in "xyz")
    }
    return {"e.xml": _LOADS.format(body=body).encode(), "plate.mot": storage(columns)}


def _wrenches(*names: str) -> bytes:
    columns = [Column("time", TIMES, "s")]
    columns += [
        Column(f"{name}.{kind}.{axis}", 0.1 * np.cos(TIMES))
        for name in names
        for kind in ("force", "torque")
        for axis in "xyz"
    ]
    return table(Result({"samples": Table(columns)}))


_LOADED = {"external_wrenches": {"push": {"frame": "l2"}}}
_DRIVEN = {"actuators": [{"type": "ideal", "name": "drive", "joints": [*JOINTS]}]}


def _rows(**columns: Any) -> bytes:
    lines = [
        ",".join(columns),
        *(",".join(map(repr, row)) for row in zip(*columns.values(), strict=True)),
    ]
    return ("\n".join(lines) + "\n").encode()


def _simulate() -> list[Seed]:
    scene = two_joints(**_LOADED, **_DRIVEN, dt=1e-3)
    files = {**scene, "m.csv": table(swing()), "w.csv": _wrenches("push")}
    commands = _rows(time=[0.0, 0.005, 0.01], **{f"{j}.effort": [0.1, 0.2, 0.3] for j in JOINTS})
    starts = _rows(**{"j1.position": [0.1, 0.2], "j2.velocity": [0.0, 0.5]})
    task = {
        "duration": 0.003,
        "start": 0.02,
        "integrator": {"type": "rk4"},
        "dt": 1e-3,
        "from": "m.csv",
        "wrenches": "w.csv",
    }
    begin = "simulate", "@s.yaml", "-o", "@o.csv"
    run = *begin, "-t", "0.003"
    return [
        Seed(
            (*begin, "--task", "@t.yaml"),
            {**files, "t.yaml": of_values(simulate=task)},
            ("t.yaml",),
        ),
        Seed((*run, "--start", "0.02", "--wrenches", "@w.csv"), files, ("w.csv",)),
        Seed((*run, "--efforts", "@u.csv"), {**scene, "u.csv": commands}, ("u.csv",)),
        Seed((*run, "--start", "0.02", "--from", "@m.csv"), files, ("m.csv",)),
        Seed(
            (*run, "--ensemble", "@e.csv", "--workers", "1"),
            {**two_joints(), "e.csv": starts},
            ("e.csv",),
        ),
    ]


def _inverse() -> list[Seed]:
    begin = "inverse", "@s.yaml", "@m.csv", "-o", "@o.csv"
    motion = {"m.csv": table(swing())}
    loaded = {**two_joints(**_LOADED), **motion, "w.csv": _wrenches("push")}
    external = {**two_joints(), **motion, **_external("l2")}
    return [
        Seed((*begin, "--wrenches", "@w.csv"), loaded, ("w.csv", "m.csv")),
        Seed((*begin, "--external", "@e.xml"), external, ("e.xml", "e.xml", "plate.mot")),
    ]


def _scale() -> list[Seed]:
    task = {"name": "subject", "mass": 3.3, "begin": 0.0, "end": 0.02}
    task["segments"] = {
        "l1": {"pairs": [["A", "B"]], "axes": "z"},
        "l2": [{"factor": 1.02, "axes": "xy"}],
    }
    files = {
        **marked(),
        "m.trc": written(capture(), "m.trc")["m.trc"],
        "t.yaml": of_values(scale=task),
    }
    words = "scale", "@s.yaml", "@m.trc", "@t.yaml", "-o", "@o"
    return [Seed(words, files, ("t.yaml", "t.yaml", "m.trc"), "o/")]


def _places() -> bytes:
    """Markers in a table, a column a number."""
    samples = capture()["samples"]
    places = {
        f"{name}.{axis}": samples[name][:, i].tolist()
        for name in "ABC"
        for i, axis in enumerate("xyz")
    }
    return _rows(time=samples["time"].tolist(), **places)


def _kinematics() -> list[Seed]:
    task = {
        "markers": {"A": 2.0, "B": 1.0},
        "coordinates": {
            "j1": {"weight": 0.5, "value": 0.1},
            "j2": {"weight": 0.5, "from_motion": True},
        },
        "motion": "m.csv",
        "begin": 0.005,
        "end": 0.03,
        "smoothness": 0.0,
        "limits": True,
        "unit": "m",
        "axes": "x,z,-y",
    }
    files = {**marked(), "c.csv": _places(), "m.csv": table(swing())}
    words = "kinematics", "@s.yaml", "@c.csv"
    return [
        Seed(
            (*words, "@t.yaml", "-o", "@o.csv"),
            {**files, "t.yaml": of_values(kinematics=task)},
            ("t.yaml",),
        ),
        Seed(
            (*words, "@t.xml", "-o", "@o.csv"),
            {**files, "t.xml": _SETUP.encode()},
            ("t.xml", "t.xml", "m.csv"),
        ),
        Seed((*words, "-o", "@o.csv"), files, ("c.csv",)),
    ]


def _loads() -> list[Seed]:
    with TemporaryDirectory() as folder:
        place = Path(folder) / "m.inp"
        solids.write_mesh(solids.box((0.04, 0.04, 0.3), (1, 1, 2)), place, 1.0)
        mesh = place.read_bytes()
    base = {"m.csv": table(swing())}
    begin = "loads", "@s.yaml", "@m.csv", "--body", "l1", "-o", "@o.csv"
    arm = {**muscled(), "m.csv": table(muscle_arm.motion(4)), "f.csv": _forces()}
    held = "--attach", "j1=bottom", "j2=top"
    meshed = *begin[:-1], "@o.inp", "--at", "0.03", "--mesh", "@m.inp", *held, "--young", "7e10"
    return [
        Seed(
            (*begin, "--external", "@e.xml"),
            {**two_joints(), **base, **_external("l2")},
            ("e.xml", "m.csv"),
        ),
        Seed(
            (*begin, "--wrenches", "@w.csv"),
            {**two_joints(**_LOADED), **base, "w.csv": _wrenches("push")},
            ("w.csv",),
        ),
        Seed(
            (*meshed, "--poisson", "0.3"),
            {**two_joints(), **base, "m.inp": mesh},
            ("m.inp",),
            "o.inp",
        ),
        Seed(
            (
                "loads",
                "@s.yaml",
                "@m.csv",
                "--body",
                "upper",
                "--muscle-forces",
                "@f.csv",
                "-o",
                "@o.csv",
            ),
            arm,
            ("f.csv",),
        ),
    ]


def _forces() -> bytes:
    motion = muscle_arm.motion(4)["samples"]
    columns = [Column("time", motion["time"], "s")]
    columns += [Column(f"{name}.force", np.full(4, 10.0), "N") for name in muscle_arm.NAMES]
    return table(Result({"samples": Table(columns)}))


def _arms() -> dict[str, bytes]:
    return {**muscled(), "m.csv": table(muscle_arm.motion(4))}


def _moment_arms() -> list[Seed]:
    return [
        Seed(("moment-arms", "@s.yaml", "@m.csv", "-o", "@o.csv"), _arms(), ("m.csv", "s.yaml"))
    ]


def _muscles() -> list[Seed]:
    emg = _rows(time=[0.0, 0.5, 1.0], **{"front.activation": [0.1, 0.2, 0.1]})
    task = {
        "objective": "stress",
        "exponent": 2.0,
        "reserves": {"shoulder": 100.0, "elbow": 100.0},
        "residuals": [
            {"name": "r", "frame": "lower", "force": [1.0, 0.0, 0.0], "optimal_force": 5.0}
        ],
        "emg": "g.csv",
        "emg_use": "track",
        "emg_weight": 3.0,
        "reactions": "child",
        "links": ["upper"],
        "by_muscle": True,
    }
    begin = "muscles", "@s.yaml", "@m.csv", "-o", "@o.csv"
    files = {**_arms(), "g.csv": emg}
    held = {"muscles": {"reserves": "r.xml"}}
    loads = _external("lower")
    loads["plate.mot"] = (
        loads["plate.mot"].replace(b"0.08\t", b"1.5\t").replace(b"0.01\t", b"-1.0\t")
    )
    wrenched = of_values(
        robot={"urdf": "r.urdf"},
        external_wrenches={"push": {"frame": "lower"}},
        **muscle_arm.SCENE,
    )
    pushed = _wrenches("push").replace(b"0.08,", b"1.5,").replace(b"0.01,", b"-1.0,")
    return [
        Seed(
            (*begin, "--task", "@t.yaml"),
            {**files, "t.yaml": of_values(muscles=task)},
            ("t.yaml", "t.yaml", "g.csv"),
        ),
        Seed(
            (*begin, "--task", "@t.yaml"),
            {**files, "t.yaml": of_values(**held), "r.xml": _RESERVES.encode()},
            ("r.xml", "r.xml", "t.yaml"),
        ),
        Seed((*begin, "--reserves", "100", "--emg", "@g.csv"), files, ("g.csv", "m.csv")),
        Seed(
            (*begin, "--reserves", "100", "--external", "@e.xml"), {**files, **loads}, ("e.xml",)
        ),
        Seed(
            (*begin, "--reserves", "100", "--wrenches", "@w.csv"),
            {**files, "s.yaml": wrenched, "w.csv": pushed},
            ("w.csv",),
        ),
    ]


def _identify() -> list[Seed]:
    files = {**two_joints(), "m.csv": table(swing(rows=60)), "h.csv": table(swing(rows=30))}
    begin = "identify", "@s.yaml", "@m.csv", "-o", "@o", "--derivatives", "given", "--partial"
    payload = "--payload", "l2=0.5,0,0,0.1"
    loaded = {
        **two_joints(**_LOADED),
        "m.csv": files["m.csv"],
        "w.csv": _wrenches("push").replace(b"0.08,", b"1.5,"),
    }
    return [
        Seed((*begin, "--held", "@h.csv", *payload), files, ("m.csv", "h.csv"), "o/"),
        Seed((*begin, "--wrenches", "@w.csv"), loaded, ("w.csv",), "o/"),
    ]


def _learn() -> list[Seed]:
    """Without torch, which none of these need to have read their files."""
    weights = _weights()
    files = {**two_joints(), "m.csv": table(swing(rows=60)), "start/weights.npz": weights}
    loaded = {**two_joints(**_LOADED), "m.csv": files["m.csv"], "w.csv": _wrenches("push")}
    words = "learn", "@s.yaml", "@m.csv", "-o", "@o", "--physics", "given"
    behind = "learning: .*torch"
    return [
        Seed((*words, "--start", "@start"), files, ("start/weights.npz",), "o/", behind),
        Seed((*words, "--wrenches", "@w.csv"), loaded, ("m.csv", "w.csv"), "o/", behind),
    ]


def _weights() -> bytes:
    """A network of one neuron a joint."""
    m, members, hidden = 2, 2, 1
    about = {"version": 1, "kind": "free", "scene": "s", "joints": [*JOINTS]}
    about |= {"low": [-1.0] * 2 * m, "high": [1.0] * 2 * m}
    about |= {key: {} for key in ("robot", "physics", "bodies", "friction", "stiffness", "given")}
    about["friction"] = {"j1": [0.1, 0.2]}
    arrays = {f"scale.{key}": np.ones(m) for key in Scales._fields}
    shapes = {"W1": (hidden, 3 * m), "b1": (hidden,), "W2": (hidden, hidden), "b2": (hidden,)}
    shapes |= {"W3": (m, hidden), "b3": (m,)}
    arrays |= {f"weight.{key}": np.full((members, *shape), 0.1) for key, shape in shapes.items()}
    arrays |= {"known.triangle": np.zeros((m, 3, 3)), "known.count": np.ones(m)}
    arrays |= {"known.usual": np.ones(m), "trust": np.ones(m), "numbers": np.zeros(1)}
    target = BytesIO()
    np.savez_compressed(target, about=np.array(json.dumps(about)), **arrays)
    return target.getvalue()


def _estimate() -> list[Seed]:
    task = {
        "estimator": {"type": "extended_kalman"},
        "inputs": "efforts",
        "disturbance": ["j2"],
        "model_noise": 0.1,
        "disturbance_noise": 3.0,
        "drifting": False,
        "lag": 0.02,
        "position_noise": 1e-3,
        "velocity_noise": 0.01,
        "position_deviation": 0.1,
        "velocity_deviation": 10.0,
        "parameters": {"l2.payload": 0.5},
        "parameter_time": 100.0,
        "limits": True,
    }
    files = {**two_joints(**_LOADED), "m.csv": table(swing()), "w.csv": _wrenches("push")}
    begin = "estimate", "@s.yaml", "@m.csv"
    horizon = {
        "estimate": {"estimator": {"type": "moving_horizon", "samples": 3}, "inputs": "none"}
    }
    return [
        Seed(
            (*begin, "@t.yaml", "-o", "@o.csv"),
            {**files, "t.yaml": of_values(estimate=task)},
            ("t.yaml",),
        ),
        Seed(
            (*begin, "@t.yaml", "-o", "@o.csv"),
            {**files, "t.yaml": of_values(**horizon)},
            ("t.yaml",),
        ),
        Seed((*begin, "--wrenches", "@w.csv", "-o", "@o.csv"), files, ("w.csv", "m.csv")),
    ]


def _payload() -> list[Seed]:
    files = {
        **two_joints(**_LOADED),
        "m.csv": table(swing(rows=60)),
        "n.csv": table(swing(rows=60)),
    }
    files["w.csv"] = _wrenches("push").replace(b"0.08,", b"1.5,")
    words = (
        "payload",
        "@s.yaml",
        "@m.csv",
        "--derivatives",
        "given",
        "--frame",
        "l2",
        "-o",
        "@o.npz",
    )
    free = {**two_joints(), "m.csv": files["m.csv"], "n.csv": files["n.csv"]}
    return [
        Seed((*words, "--partial", "--without", "@n.csv"), free, ("m.csv", "n.csv"), "o.npz"),
        Seed((*words, "--partial", "--wrenches", "@w.csv"), files, ("w.csv",), "o.npz"),
    ]


def _gait() -> list[Seed]:
    task = {
        "guesses": [{}],
        "cycles": 1,
        "continuation": {"parameter": "slope", "from": 0.009, "to": 0.0091},
        "basin": {"grid": {"left_hip.velocity": [0.19, 0.21, 2]}, "cycles": 2},
        "longest": 0.02,  # s: no cycle is that short, and the search ends
    }
    words = "gait", "simplest_walker_step", "@t.yaml", "-o", "@o.csv", "--workers", "1"
    return [
        Seed(words, {"t.yaml": of_values(gait=task)}, ("t.yaml",), behind="longer time in longest")
    ]


def _follow() -> list[Seed]:
    files = {**two_joints(**_DRIVEN), "m.csv": table(swing())}
    words = "follow", "@s.yaml", "@m.csv", "-o", "@o.npz", "--tube", "0"
    return [Seed(words, files, ("m.csv",), "o.npz")]


_MOTIONS = ("m.csv", "n.csv", "g.csv")  # recorded, tracked and guessed


def _predict() -> list[Seed]:
    scene = of_values(
        robot={"urdf": "r.urdf"}, actuators=[{"type": "ideal", "joints": ["slide"], "limit": 50.0}]
    )
    task = {
        "duration": [0.5, 1.0],
        "start": {"slide.position": 0.0, "slide.velocity": 0.0},
        "end": {"slide.position": 1.0, "slide.velocity": 0.0},
        "bounds": {"slide.position": [-2.0, 2.0]},
        "goals": [{"type": "effort", "weight": 0.5}, {"type": "time"}],
        "mesh": {"intervals": 2, "degree": 2},
        "tolerance": 1e-2,
        "accuracy": 1e-6,
        "iterations": 30,
        "guess": {"slide.position": [0.0, 1.0]},
    }
    tracking = {
        "recording": {"motion": "m.csv", "times": [0.01, 0.05]},
        "goals": [
            {"type": "tracking", "of": "*.position", "weight": 100.0, "file": "n.csv"},
            {"type": "effort", "weight": 1e-4},
        ],
        "mesh": {"intervals": 2, "degree": 2},
        "tolerance": 1e-1,
        "iterations": 30,
        "guess": "g.csv",
    }
    motion = table(swing(("slide",)))
    files = {"s.yaml": scene, "r.urdf": _RAIL.encode(), **dict.fromkeys(_MOTIONS, motion)}
    words = "predict", "@s.yaml", "@t.yaml", "-o", "@o.npz"
    return [
        Seed(words, {**files, "t.yaml": of_values(predict=one)}, ("t.yaml", *mutated), "o.npz")
        for one, mutated in ((task, ()), (tracking, _MOTIONS))
    ]


_TRIMER = "particles/trimer"


def _sample() -> list[Seed]:
    task = {
        "temperature": 1.0,
        "method": "metropolis",
        "chains": 2,
        "samples": 8,
        "warmup": 2,
        "steps": 2,
        "dt": 0.02,
        "seed": 0,
        "fixman": False,
        "components": False,
        "kinetics": True,
        "observe": {"bend": "cosine A B C", "ends": "distance A C"},
        "histograms": {"bend": [-1.0, 1.0, 10]},
    }
    words = "sample", _TRIMER, "@t.yaml", "-o", "@o.csv", "--workers", "1"
    task_file = of_values(sample=task)
    files = {"t.yaml": task_file, "c.npz": _checkpoint(task_file)}
    swept = of_values(
        sample={
            "temperature": 1.0,
            "chains": 2,
            "samples": 8,
            "warmup": 1,
            "coordinate": "distance A C",
            "at": [1.4],
        }
    )
    return [
        Seed(words, files, ("t.yaml",)),
        Seed((*words, "--continue", "@c.npz"), files, ("c.npz",)),
        Seed(words, {"t.yaml": swept}, ("t.yaml",)),
    ]


@cache
def _checkpoint(task: bytes) -> bytes:
    with TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "t.yaml").write_bytes(task)
        words = [
            "sample",
            _TRIMER,
            f"{place}/t.yaml",
            "--workers",
            "1",
            "--checkpoint",
            f"{place}/c.npz",
        ]
        with redirect_stdout(StringIO()):
            code = cli.main(words)
        if code:
            raise RuntimeError(f"{words} failed")
        return (place / "c.npz").read_bytes()


def _plot() -> list[Seed]:
    files = {"m.csv": table(swing())}
    return [
        Seed(
            ("plot", "@m.csv", "-o", "@o.svg", "--columns", "j1.position"),
            files,
            ("m.csv",),
            "o.svg",
        )
    ]


def _view() -> list[Seed]:
    files = {**two_joints(), "m.csv": table(swing()), "g.csv": table(swing())}
    words = "view", "@s.yaml", "@m.csv", "--ghost", "@g.csv", "-o", "@o.html"
    return [Seed(words, files, ("m.csv", "g.csv"), "o.html")]


SEEDS: Mapping[str, Callable[[], list[Seed]]] = MappingProxyType(
    {
        "simulate": _simulate,
        "inverse": _inverse,
        "scale": _scale,
        "kinematics": _kinematics,
        "loads": _loads,
        "moment-arms": _moment_arms,
        "muscles": _muscles,
        "identify": _identify,
        "learn": _learn,
        "estimate": _estimate,
        "payload": _payload,
        "gait": _gait,
        "follow": _follow,
        "predict": _predict,
        "sample": _sample,
        "plot": _plot,
        "view": _view,
    }
)
