"""What layers may import from other packages, and what the core may not touch.

The order of the rooms is the subject of `test_house`.
"""

import ast
import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple

import pytest
from places import ROOT

FILES = sorted(
    p.relative_to(ROOT) for d in ("mbd_ros", "msg_adapters") for p in (ROOT / d).rglob("*.py")
)

PROGRAMS = {"mbd_ros.programs", "mbd_ros.__main__", "mbd_ros.nodes.__main__"}
CORE, METHODS, NODES = "mbd_ros.core", "mbd_ros.methods", "mbd_ros.nodes"
PART_FOLDERS = {
    f"mbd_ros.parts.{folder}"
    for folder in (
        "actuators",
        "constraints",
        "contacts",
        "controllers",
        "estimators",
        "forces",
        "integrators",
        "muscles",
        "sensors",
        "stabilization",
    )
}
APPLICATIONS = {
    "mbd_ros.applications.demo",
    "mbd_ros.applications.report",
    "mbd_ros.view",
    "mbd_ros.cli",
    *PROGRAMS,
}
NAMES_ONLY = "mbd_ros.nodes.table.NODES"  # which nodes there are, and where
BY_SCIPY = {"mbd_ros.methods.signals", "mbd_ros.scene.particles.neighbour_tree"}
STARTS = {(m, "mbd_ros.nodes.start") for m in ("mbd_ros.programs", "mbd_ros.nodes.__main__")}
QP_SOLVERS = f"{CORE}.optimization.qp_solvers"
MATH = {"numpy", "pinocchio", "eigenpy", "coal"}
WORLD = {"time", "datetime", "logging", "os", "io", "pathlib", "shutil", "socket", "subprocess"}
SHELL_ONLY = {"rclpy", "rosbags", "yaml", "matplotlib", "msg_adapters"}
FILE_READERS = {"mbd_ros.regular_file", "mbd_ros.gzip_file"}
ALLOWED = {
    "mbd_ros.errors": set(),
    "msg_adapters": {"numpy", "msg_adapters"},
    CORE: {*MATH, "mbd_ros"},
    METHODS: {*MATH, "mbd_ros"},
    "mbd_ros.compiled": {
        *MATH,
        "casadi",
        "mbd_ros.errors",
        *FILE_READERS,
        CORE,
        METHODS,
        "mbd_ros.compiled",
    },
    "mbd_ros.scene": {
        *MATH,
        "yaml",
        "mbd_ros.errors",
        *FILE_READERS,
        CORE,
        METHODS,
        "mbd_ros.compiled",
        "mbd_ros.scene",
    },
}
UNNAMED = {  # by an empty scene: events, contacts, internal states, several robots, paths
    f"mbd_ros.{module}"
    for module in (
        "core.complementarity.contact_problem",
        "core.contact_modes.event_rows",
        "core.dynamics.internal_dynamics",
        "core.dynamics.phased_system",
        "core.dynamics.world_axes",
        "core.geometry",
        "core.kinematics.paths",
        "core.model.members",
        "core.muscles",
        "core.nonsmooth.frictional_impacts",
        "methods.events",
    )
}
UNWANTED = {"casadi", "proxsuite", "qpsolvers", "scipy", "matplotlib", "rosbags", "rclpy"}


LAYERS = (*ALLOWED, NODES)


class Import(NamedTuple):
    name: str
    line: int
    at_module_level: bool


def imports(tree):
    """Every import, as the dotted name of what is imported."""
    inside = {
        id(n)
        for function in ast.walk(tree)
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef)
        for n in ast.walk(function)
    }
    for n in ast.walk(tree):
        if isinstance(n, ast.Import):
            names = [alias.name for alias in n.names]
        elif isinstance(n, ast.ImportFrom):
            names = [f"{'.' * n.level}{n.module or ''}.{alias.name}" for alias in n.names]
        else:
            continue
        yield from (Import(name, n.lineno, id(n) not in inside) for name in names)


def within(name, roots):
    return any(name == root or name.startswith(root + ".") for root in roots)


def layer(module):
    """The part of the package that the rules below speak of; None for other modules."""
    if within(module, PART_FOLDERS):
        return "parts"
    return next((name for name in LAYERS if within(module, {name})), None)


def refused(path, found):
    """Why a file may not have this import, or None."""
    module = ".".join(Path(path).with_suffix("").parts)
    name, here, there = found.name, layer(module), layer(found.name)
    if name.startswith("."):
        return "is relative"
    if within(name, {"proxsuite", "qpsolvers"}) and module == QP_SOLVERS:
        return "is at module level" if found.at_module_level else None
    if here in (CORE, METHODS, "parts") and within(name, WORLD | {"importlib"}):
        return "touches the world"
    if name.split(".")[0] in sys.stdlib_module_names:
        return None if here != "mbd_ros.errors" else "is not for errors"
    if (within(name, {"scipy"}) and within(module, BY_SCIPY)) or (
        module,
        name.rpartition(".")[0],
    ) in STARTS:
        return None
    if name == NAMES_ONLY:
        return None
    if here in ALLOWED and not within(name, ALLOWED[here]):
        return f"is not for {here}"
    if here == "parts" and (there == here or within(name, SHELL_ONLY) or ros(name)):
        return "is not for a part"
    if within(module, APPLICATIONS) and there == NODES and found.at_module_level:
        return "brings ROS nodes in at module level"
    return None


def ros(name):
    return name.split(".")[0].endswith(("_msgs", "_srvs", "_interfaces"))


def violations(path, source):
    """Lines of a file that break the table."""
    tree = ast.parse(source)
    rows = [(i.line, f"{i.name} {why}") for i in imports(tree) if (why := refused(path, i))]
    if layer(".".join(Path(path).with_suffix("").parts)) in (CORE, METHODS, "parts"):
        rows += [
            (n.lineno, f"{ast.unparse(n)} touches the world")
            for n in ast.walk(tree)
            if isinstance(n, ast.Call)
            and isinstance(n.func, ast.Name)
            and n.func.id in ("open", "print", "input")
        ]
        rows += [(n.lineno, "global state") for n in ast.walk(tree) if isinstance(n, ast.Global)]
    return [f"{path}:{line} {what}" for line, what in sorted(rows)]


def test_every_file_keeps_to_its_layer():
    rows = [row for p in FILES for row in violations(p, (ROOT / p).read_text(encoding="utf-8"))]
    assert not rows, "\n".join(rows)


THRESHOLDS = "mbd_ros/core/thresholds.py"
RANK_WORDS = ("TOGGLE", "FOLD", "RANK", "SINGULAR", "REDUNDANT", "TINY")


def numbers(path):
    """Names of the module-level floats of a file, without leading underscores."""
    for n in ast.parse((ROOT / path).read_text(encoding="utf-8")).body:
        if isinstance(n, ast.Assign) and isinstance(getattr(n.value, "value", None), float):
            yield from (t.id.strip("_") for t in n.targets if isinstance(t, ast.Name))


def test_a_threshold_has_one_home_and_a_use():
    known = set(numbers(THRESHOLDS))
    others = [str(p) for p in FILES if str(p) != THRESHOLDS]
    again = [
        f"{path}: {name}"
        for path in others
        for name in numbers(path)
        if name in known or any(word in name.split("_") for word in RANK_WORDS)
    ]
    assert not again, "\n".join(again)
    text = "".join((ROOT / path).read_text(encoding="utf-8") for path in others)
    assert [name for name in known - {"REDUNDANT"} if name not in text] == []


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("mbd_ros/errors.py", "import math"),
        ("mbd_ros/core/model/robot.py", "import rclpy"),
        ("mbd_ros/core/model/robot.py", "from . import state"),
        ("mbd_ros/core/model/robot.py", "import scipy.linalg"),
        ("mbd_ros/core/model/robot.py", "def f():\n    import proxsuite"),
        ("mbd_ros/core/optimization/qp_solvers.py", "import proxsuite"),
        ("mbd_ros/core/model/robot.py", "from time import monotonic"),
        ("mbd_ros/core/model/robot.py", "import logging"),
        ("mbd_ros/core/model/robot.py", "def f(p):\n    return open(p)"),
        ("mbd_ros/core/model/robot.py", "print(1)"),
        ("mbd_ros/parts/forces/spring.py", "from mbd_ros.parts.contacts.plane import Plane"),
        ("mbd_ros/parts/forces/spring.py", "import yaml"),
        ("mbd_ros/parts/forces/spring.py", "from sensor_msgs.msg import JointState"),
        ("mbd_ros/scene/reader.py", "import rclpy"),
        (
            "mbd_ros/scene/schema/registry.py",
            "from mbd_ros.parts.forces.joint_spring import JointSpring",
        ),
        ("mbd_ros/scene/reader.py", "from mbd_ros.nodes.shell.shell import Shell"),
        ("msg_adapters/wrench.py", "import rclpy"),
        ("msg_adapters/wrench.py", "from geometry_msgs.msg import Wrench"),
        ("msg_adapters/wrench.py", "from mbd_ros.errors import MbdError"),
        ("mbd_ros/applications/demo/run.py", "import mbd_ros.nodes.shell.shell"),
        ("mbd_ros/cli.py", "from mbd_ros.nodes.inverse_dynamics.node import InverseDynamicsNode"),
    ],
)
def test_a_forbidden_line_is_seen(path, source):
    assert len(violations(path, source)) == 1


@pytest.mark.parametrize(
    ("path", "source"),
    [
        ("mbd_ros/core/optimization/qp_solvers.py", "def build():\n    import proxsuite"),
        (
            "mbd_ros/core/model/robot.py",
            "import math, numpy as np, pinocchio\nfrom mbd_ros.core import state",
        ),
        (
            "mbd_ros/parts/forces/spring.py",
            "import numpy\nfrom mbd_ros.core.model.robot import Robot",
        ),
        ("mbd_ros/cli.py", "def f():\n    from mbd_ros.nodes.simulator.node import SimulatorNode"),
        (
            "mbd_ros/nodes/shell/shell.py",
            "import rclpy, time\nfrom mbd_ros.scene.reader import load_scene",
        ),
    ],
)
def test_an_allowed_line_passes(path, source):
    assert violations(path, source) == []


def test_a_heavy_library_has_one_part_file():
    owners = {}
    for path in (p for p in FILES if ".".join(p.parts[:3]) in PART_FOLDERS):
        for found in imports(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
            library = found.name.split(".")[0]
            if library not in {*sys.stdlib_module_names, *MATH, "mbd_ros"}:
                owners.setdefault(library, set()).add(path)
    assert {name: files for name, files in owners.items() if len(files) > 1} == {}


def test_every_init_but_that_of_the_package_is_empty():
    filled = [p for p in FILES if p.name == "__init__.py" and (ROOT / p).stat().st_size]
    assert filled == [Path("mbd_ros/__init__.py")]


def loaded_by_check(scene):
    """Modules that a fresh process holds after `mbd-ros check`."""
    code = "import json, sys; from mbd_ros.cli import main; code = main(['check', sys.argv[1]]); "
    code += "print(json.dumps([code, sorted(sys.modules)]))"
    ran = subprocess.run(
        [sys.executable, "-c", code, str(scene)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    status, modules = json.loads(ran.stdout.splitlines()[-1])
    assert status == 0, ran.stderr
    return modules


def test_the_package_alone_imports_nothing():
    code = "import importlib, sys; before = {*sys.modules}; import mbd_ros; "
    code += "print({*sys.modules} - before)"
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert ran.stdout == "{'mbd_ros'}\n"


def test_an_empty_scene_imports_nothing_that_it_does_not_use():
    modules = loaded_by_check(ROOT / "config/scenes/empty.yaml")
    assert "mbd_ros.methods.inverse_dynamics.inverse_dynamics" in modules
    assert [m for m in modules if within(m, UNWANTED | PART_FOLDERS | UNNAMED)] == []


def test_a_scene_imports_the_parts_that_it_names(tmp_path):
    shutil.copy(ROOT / "config/robots/pendulum.urdf", tmp_path)
    scene = tmp_path / "sprung.yaml"
    scene.write_text(
        "robot: {urdf: pendulum.urdf}\n"
        "forces: [{type: joint_spring, joint: hinge, stiffness: 1.0}]\n",
        encoding="utf-8",
    )
    parts = [m for m in loaded_by_check(scene) if within(m, PART_FOLDERS)]
    assert parts == ["mbd_ros.parts.forces", "mbd_ros.parts.forces.joint_spring"]
