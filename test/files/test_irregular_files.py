"""FIFOs, sockets and devices in place of files: refused at once, whoever reads them."""

import os
import signal
import socket
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from mbd_ros.applications.report.page import put_headlines
from mbd_ros.cli import main
from mbd_ros.errors import MbdError
from mbd_ros.features.identification.learn.job import WEIGHTS, read_folder
from mbd_ros.features.loads.fem.mesh import read_mesh as read_solids
from mbd_ros.features.markers.osim_setup import read_setup
from mbd_ros.features.muscles.osim_reserves import read_reserves
from mbd_ros.features.sampling.chains import read_checkpoint
from mbd_ros.files.bags.bag_writer import BagWriter
from mbd_ros.files.formats import FOLDER, FORMATS, PICTURES
from mbd_ros.files.laboratory.external_loads import read_external_loads
from mbd_ros.parts.forces.learned_torque import LearnedTorque
from mbd_ros.scene.particles.placement import read_coordinates
from mbd_ros.scene.reading.learned_entries import with_files
from mbd_ros.scene.reading.mesh_file import read_mesh
from mbd_ros.view.meshes import mesh_surface

PATIENCE = 5.0  # s
TABLES = sorted(set(FORMATS) - {FOLDER, *PICTURES})
ARM = "package://mbd_ros/config/scenes/arm7.yaml"
BODY = '<mujoco><asset><mesh name="m" file="x.stl"/></asset><worldbody><body><joint/><geom \
type="mesh" mesh="m"/></body></worldbody></mujoco>'
LOADS = "<ExternalLoads><datafile>x.mot</datafile><objects><ExternalForce name='f'> \
<applied_to_body>b</applied_to_body><force_identifier>f</force_identifier></ExternalForce> \
</objects></ExternalLoads>"
READERS = {  # file -> what reads it by its path
    "x.gro": partial(read_coordinates, where="positions"),
    "x.obj": partial(read_mesh, scale=(1.0, 1.0, 1.0), where="mesh"),
    "x.stl": partial(mesh_surface, scale=(1.0, 1.0, 1.0), where="mesh"),
    "x.msh": partial(read_solids, per_metre=1.0),
    "setup.xml": read_setup,
    "reserves.xml": partial(read_reserves, robot=None, couplings=None),
    "loads.xml": read_external_loads,
    "x.npz": partial(read_checkpoint, sizes=[(1, 1)]),
    WEIGHTS: lambda path: read_folder(path.parent),
    "x.onnx": lambda path: with_files(LearnedTorque, {"model": path.name}, "f", path.parent),
    "README.md": lambda path: list(put_headlines(path, path.parent)),
    "report.json": lambda path: list(put_headlines(path.with_name("y.md"), path.parent)),
}
NAMING = {  # file -> name and text of a file that names it
    "x.urdf": ("scene.yaml", "robot: {urdf: x.urdf}"),
    "x.osim": ("scene.yaml", "robot: {osim: x.osim}"),
    "include.xml": ("model.xml", '<mujoco><include file="include.xml"/></mujoco>'),
    "x.stl": ("model.xml", BODY),
}


def fifo(path):
    os.mkfifo(path)


def unix_socket(path):
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(path.name)  # a long path is refused


def device(path):
    path.symlink_to("/dev/zero")


@pytest.fixture(params=[fifo, unix_socket, device])
def plant(request, tmp_path, monkeypatch):
    """Puts one of them in the place of a file; whoever waits for it is interrupted."""

    def interrupt(number, frame):
        raise AssertionError(f"waited for {PATIENCE} s")

    monkeypatch.chdir(tmp_path)
    previous = signal.signal(signal.SIGALRM, interrupt)
    signal.setitimer(signal.ITIMER_REAL, PATIENCE)
    yield lambda name: request.param(Path(name))
    signal.setitimer(signal.ITIMER_REAL, 0.0)
    signal.signal(signal.SIGALRM, previous)


def check_refused(words, name, capsys):
    assert main(words) == 2
    assert name in capsys.readouterr().err


@pytest.mark.parametrize("name", [f"x{suffix}" for suffix in TABLES])
def test_tables_and_bags_are_regular_files(plant, capsys, name):
    plant(name)
    check_refused(["plot", name, "-o", "x.png"], name, capsys)


@pytest.mark.parametrize("inside", ["metadata.yaml", "bag_0.mcap"])
def test_files_inside_of_bags_are_regular_files(plant, capsys, inside):
    with BagWriter("bag") as bag:
        bag.write("/a", "std_msgs/msg/Float64MultiArray", 1, bytes(24))
    (file,) = [file for file in Path("bag").iterdir() if file.suffix == Path(inside).suffix]
    file.rename("kept")
    os.chdir("bag")
    plant(file.name)
    os.chdir("..")
    check_refused(["plot", "bag", "-o", "x.png"], file.name, capsys)


@pytest.mark.parametrize("name", ["x.yaml", "x.osim", "x.osim.gz", "x.xml"])
@pytest.mark.parametrize("words", [["check"], ["import-opensim"], ["import-mjcf"]])
def test_scenes_and_models_are_regular_files(plant, capsys, words, name):
    plant(name)
    check_refused([*words, name], name, capsys)


@pytest.mark.parametrize("name", NAMING)
def test_files_that_scenes_and_models_name_are_regular_files(plant, capsys, name):
    plant(name)
    place, text = NAMING[name]
    Path(place).write_text(text, encoding="utf-8")
    check_refused(["check", place], name, capsys)


@pytest.mark.parametrize("command", ["predict", "estimate", "sample"])
def test_tasks_are_regular_files(plant, capsys, command):
    plant("task.yaml")
    Path("motion.csv").write_text("time\n0\n1\n", encoding="utf-8")
    motion = ["motion.csv"] if command == "estimate" else []
    check_refused([command, ARM, *motion, "task.yaml", "-o", "x.npz"], "task.yaml", capsys)


def test_the_data_of_external_loads_are_a_regular_file(plant):
    plant("x.mot")
    Path("loads.xml").write_text(LOADS, encoding="utf-8")
    with pytest.raises(MbdError, match=r"x\.mot: .*not a regular file"):
        read_external_loads("loads.xml")


OBJECT = "{}v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n"
HEAVY = '<X><DataItem Format="HDF">other.h5:/a</DataItem></X>'
WITH_MESHES = {  # file that libraries open by themselves -> mesh that leads to it, and its reader
    "other.mtl": ("x.obj", OBJECT.format("mtllib other.mtl\n"), READERS["x.obj"]),
    "x.mtl": ("x.obj", OBJECT.format(""), READERS["x.stl"]),
    "other.inp": ("x.inp", "*INCLUDE, INPUT=other.inp\n", READERS["x.msh"]),
    "x.node": ("x.ele", "0 4 0\n", READERS["x.msh"]),
    "x_a.xml": ("x.xml", "<dolfin/>", READERS["x.msh"]),
    "other.h5": (
        "x.xdmf",
        '<X><DataItem Format="HDF">other.h5:/a</DataItem></X>',
        READERS["x.msh"],
    ),
}


@pytest.mark.parametrize("name", WITH_MESHES)
def test_files_that_belong_to_meshes_are_regular(plant, name):
    plant(name)
    place, text, read = WITH_MESHES[name]
    Path(place).write_text(text, encoding="utf-8")
    with pytest.raises(MbdError, match="not a regular file"):
        read(Path(place).absolute())


def test_meshes_that_include_one_another_are_refused(tmp_path):
    (tmp_path / "x.inp").write_text(f"*INCLUDE, INPUT={tmp_path}/y.inp\n", encoding="utf-8")
    (tmp_path / "y.inp").write_text("*Include, Input=x.inp\n", encoding="utf-8")
    with pytest.raises(MbdError, match=r"x\.inp includes itself"):
        read_solids(tmp_path / "x.inp", 1.0)


@pytest.mark.parametrize("name", READERS)
def test_other_files_are_regular(plant, name):
    if name == "README.md":
        Path("report.json").write_text("{}", encoding="utf-8")
    plant(name)
    with pytest.raises(MbdError, match=name):
        READERS[name](Path(name).absolute())


def test_a_link_to_a_regular_file_is_read(tmp_path):
    np.savez(tmp_path / "real.npz", q0=np.zeros((1, 1)), v0=np.zeros((1, 1)), sweeps0=1, dt0=1.0)
    (tmp_path / "link.npz").symlink_to("real.npz")
    assert read_checkpoint(tmp_path / "link.npz", [(1, 1)])[0].dt == 1.0
