"""What pip and colcon install."""

import ast
import importlib
import importlib.metadata
import inspect
import re
import shutil
import subprocess
import sys
import zipfile
from configparser import ConfigParser
from pathlib import Path
from xml.etree import ElementTree

import pytest
from places import ROOT

from mbd_ros.nodes.table import NODES
from mbd_ros.scene.schema.registry import PARTS, resolve

PACKAGE = ElementTree.parse(ROOT / "package.xml").getroot()
SOURCES = ["setup.py", "setup.cfg", "pyproject.toml", "package.xml", "LICENSE"]
FOLDERS = ["mbd_ros", "msg_adapters", "resource", "launch", "config", "test"]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    """The wheel that pip builds from a copy of the sources, without the network."""
    copy, out = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("wheel")
    for name in SOURCES:
        shutil.copy(ROOT / name, copy)
    for name in FOLDERS:
        shutil.copytree(ROOT / name, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
    words = ["wheel", "--quiet", "--no-deps", "--no-index", "--no-build-isolation", "-w"]
    subprocess.run([sys.executable, "-m", "pip", *words, out, copy], check=True)
    (built,) = out.glob("*.whl")
    with zipfile.ZipFile(built) as archive:
        yield archive


def read(wheel, ending):
    (name,) = (n for n in wheel.namelist() if n.endswith(ending))
    return wheel.read(name).decode()


def names(folder, pattern="*"):
    found = (p for p in (ROOT / folder).rglob(pattern) if p.is_file() and p.suffix != ".pyc")
    return {p.relative_to(ROOT).as_posix() for p in found}


def plain(requirement):
    return re.match(r"[\w.-]+", requirement)[0].lower().replace("_", "-")


def test_ros_sees_a_format_3_ament_python_package():
    assert PACKAGE.get("format") == "3"
    assert PACKAGE.findtext("name") == "mbd_ros"
    assert PACKAGE.findtext("export/build_type") == "ament_python"
    assert PACKAGE.findtext("license") == "Apache-2.0"
    assert (ROOT / "resource" / "mbd_ros").is_file()


def test_every_ros_package_imported_is_declared():
    declared = {e.text for e in PACKAGE.findall("exec_depend")}
    used = set()
    for path in names("mbd_ros", "*.py") | names("launch", "*.py"):
        for n in ast.walk(ast.parse((ROOT / path).read_text(encoding="utf-8"))):
            if isinstance(n, ast.Import):
                used |= {alias.name.split(".")[0] for alias in n.names}
            elif isinstance(n, ast.ImportFrom) and n.module:
                used.add(n.module.split(".")[0])
    ros = {
        u for u in used if re.search(r"^(rclpy|launch\w*|ament_\w+)$|_(msgs|srvs|interfaces)$", u)
    }
    assert "rclpy" in ros
    assert ros <= declared


def test_one_version_everywhere(wheel):
    version = PACKAGE.findtext("version")
    assert Path(wheel.filename).name.startswith(f"mbd_ros-{version}-")
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.search(r"^## \[?(\d+\.\d+\.\d+)", changes, re.MULTILINE)[1] == version


def test_the_wheel_shares_every_launch_and_config_file(wheel):
    prefix = f"mbd_ros-{PACKAGE.findtext('version')}.data/data/share/"
    shared = {n.removeprefix(prefix) for n in wheel.namelist() if n.startswith(prefix)}
    marker = "ament_index/resource_index/packages/mbd_ros"
    wanted = {f"mbd_ros/{n}" for n in names("config") | names("launch")}
    assert "mbd_ros/config/scenes/empty.yaml" in wanted
    assert shared == wanted | {marker, "mbd_ros/package.xml"}


def test_the_wheel_holds_every_module_and_no_test_or_recording(wheel):
    modules = {n for n in wheel.namelist() if n.endswith(".py") and ".data/" not in n}
    assert modules == names("mbd_ros", "*.py") | names("msg_adapters", "*.py")
    assert {n.split("/")[0] for n in wheel.namelist()} <= {
        *("mbd_ros", "msg_adapters"),
        *(f"mbd_ros-{PACKAGE.findtext('version')}.{kind}" for kind in ("data", "dist-info")),
    }


def test_the_licence_travels_with_the_wheel(wheel):
    assert "Apache License" in read(wheel, "LICENSE")
    assert read(wheel, "LICENSE") == (ROOT / "LICENSE").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def described():
    """The keys that the generated reference explains, by part: the rows below its heading."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT / "docs/site"))
        page = importlib.import_module("scene_reference").page()
    row = re.compile(r"^\| `(\w+)` \|.* \| (?:[^|]|\\\|)+ \|$", re.MULTILINE)
    pieces = page.split("\n### ")[1:]
    return {(piece.partition("\n")[0], frozenset(row.findall(piece))) for piece in pieces}


@pytest.mark.parametrize(
    ("section", "part"),
    [
        (s, name)
        for s, parts in PARTS.items()
        if s not in ("controllers", "estimators")
        for name in parts
    ],
)
def test_every_key_of_every_part_is_documented(section, part, described):
    """With its meaning, in the reference that `make docs` generates."""
    keys = set(inspect.signature(resolve(section, part, "")).parameters) - {"robot"}
    assert any(name == part and keys <= explained for name, explained in described)


def test_the_changelog_counts_the_benchmark_scenes():
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    count = len(list((ROOT / "config/scenes/benchmark").glob("*.yaml")))
    assert f" {count} benchmark scenes " in changes


def test_every_entry_point_of_the_wheel_loads(wheel):
    parser = ConfigParser()
    parser.read_string(read(wheel, "entry_points.txt"))
    scripts = dict(parser["console_scripts"])
    assert scripts.keys() == {"mbd-ros", *NODES}
    for name, target in scripts.items():
        point = importlib.metadata.EntryPoint(name, target, "console_scripts")
        assert callable(point.load())


def test_every_requirement_has_an_exact_pin(wheel):
    texts = [
        (ROOT / f"requirements/{n}.txt").read_text(encoding="utf-8")
        for n in ("pins", "report", "docs", "learn", "ziglang")
    ]
    lines = "".join(texts).splitlines()
    pins = [line for line in lines if not line.startswith("#")]
    exact = re.compile(r'[\w.-]+==[\w.]+(; python_version (<|>=) "3.11")?')
    assert [p for p in pins if not exact.fullmatch(p)] == []
    required = re.findall(r"^Requires-Dist: (.*)", read(wheel, "METADATA"), re.MULTILINE)
    assert len(required) > 10
    assert {plain(r) for r in required} - {plain(p) for p in pins} == set()


def parameters_of(executable):
    """Names of the parameters of the node behind an executable."""
    module, _, name = NODES[executable].partition(":")
    node = getattr(importlib.import_module(module), name)
    assert executable == node.NAME
    shell = importlib.import_module("mbd_ros.nodes.shell.parameters").PARAMETERS
    return {parameter.name for parameter in node.PARAMETERS + shell} | {"use_sim_time"}


def calls_of(path):
    """Calls in a file, with the names of what is called."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    calls = [n for n in ast.walk(tree) if isinstance(n, ast.Call)]
    return [(getattr(call.func, "id", ""), call) for call in calls]


def literal(path, name):
    """The value of a name that a file gives at its top; `launch` itself comes with ROS only."""
    body = ast.parse((ROOT / path).read_text(encoding="utf-8")).body
    (value,) = (n.value for n in body if isinstance(n, ast.Assign) and n.targets[0].id == name)
    return ast.literal_eval(value)


def first_words(named, *functions):
    """First arguments of calls of some functions, where they are given as text."""
    first = [call.args[0] for name, call in named if name in functions]
    return {argument.value for argument in first if isinstance(argument, ast.Constant)}


LAUNCHING = "mbd_ros/nodes/launching.py"
ARGUMENTS, TOPICS = literal(LAUNCHING, "ARGUMENTS"), literal(LAUNCHING, "TOPICS")
LOOPS = {"launch/bringup.launch.py", "launch/demo.launch.py"}  # of several nodes


@pytest.mark.parametrize("path", sorted(names("launch", "*.py") - LOOPS))
def test_a_launch_file_of_a_node_names_what_there_is(path):
    ((_, call),) = (named for named in calls_of(path) if named[0] == "node_launch")
    name, *topics = (argument.value for argument in call.args)
    assert path == f"launch/{name}.launch.py"
    assert set(topics) <= TOPICS.keys() & ARGUMENTS.keys()
    assert (ROOT / f"config/nodes/{name}.yaml").is_file()
    clock = {k.arg: k.value.value for k in call.keywords}.get("clock", "use_sim_time")
    assert {"scene", "autostart", clock} <= parameters_of(name)


@pytest.mark.parametrize("path", sorted({*LOOPS, LAUNCHING}))
def test_launch_files_of_loops_name_what_there_is(path):
    """Executables, parameters, arguments and files."""
    named = calls_of(path)
    for call in (c for n, c in named if n == "LifecycleNode"):
        node = {k.arg: k.value for k in call.keywords}
        assert "namespace" in node
        if path in LOOPS:
            executable = node["executable"].value
            assert (node["package"].value, node["name"].value) == ("mbd_ros", executable)
            (values,) = (e for e in node["parameters"].elts if isinstance(e, ast.Dict))
            assert {key.value for key in values.keys} <= parameters_of(executable)
    assert first_words(named, "node") <= NODES.keys()
    for call in (c for n, c in named if n == "DeclareLaunchArgument"):
        assert {"default_value", "description"} <= {k.arg for k in call.keywords}
    used = first_words(named, "LaunchConfiguration", "typed")
    assert used <= first_words(named, "DeclareLaunchArgument") | ARGUMENTS.keys()
    for _, call in (entry for entry in named if entry[0] == "shared_file"):
        if all(isinstance(part, ast.Constant) for part in call.args):
            assert ROOT.joinpath(*(part.value for part in call.args)).exists()
