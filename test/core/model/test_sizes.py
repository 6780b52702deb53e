"""Sizes: what is accepted works, what is not is refused before work is done, with its number."""

import gzip
import json
import os
import random
import subprocess
import sys

import numpy as np
import pytest
from fuzz import tables, urdf
from fuzz.trial import Case, behaves

from mbd_ros import cli
from mbd_ros.core.model.coupling_functions import natural_cubic_spline
from mbd_ros.core.model.urdf import MAX_JOINTS
from mbd_ros.errors import DataError
from mbd_ros.files.tables.csv import MAX_CELLS, read_table, write_table

ROBOT = urdf.robot(random.Random(3), 3)
JOINT = ROBOT.joints[0]
STOP = {"type": "joint_stop", "joint": JOINT}
CLOSURE = {"type": "loop_closure", "frame_a": "universe", "frame_b": "l1"}
SPRING = {"type": "joint_spring", "joint": JOINT, "stiffness": 1.0}


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """A function that writes a scene, and the words that check it."""
    monkeypatch.setattr("mbd_ros.scene.describe.check.MEASURED", 0.0)
    (tmp_path / "r.urdf").write_text(ROBOT.text)

    def write(text=None, **sections):
        given = text or json.dumps({"robot": {"urdf": "r.urdf"}, **sections})
        (tmp_path / "s.yaml").write_text(given)
        return str(tmp_path / "s.yaml")

    return write


def in_a_process(program):
    """What a program prints, and the largest size of its memory [KiB]."""
    program += "\nprint(open('/proc/self/status').read())"
    done = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, check=True)
    said, _, status = done.stdout.decode().partition("Name:")
    return said, int(status.partition("VmHWM:")[2].split()[0])


@pytest.mark.parametrize(
    ("sections", "told"),
    [
        ({"constraints": [STOP] * 15_000}, "constraints: 15000 entries, accepted are 1000"),
        ({"constraints": [STOP] * 601}, "constraints: 601 rows, accepted are 600"),
        ({"constraints": [CLOSURE] * 2_000}, "constraints: 2000 entries, accepted are 1000"),
        ({"constraints": [CLOSURE] * 201}, "constraints: 603 rows, accepted are 600"),
        ({"forces": [SPRING] * 15_000}, "forces: 15000 entries, accepted are 1000"),
        (
            {"external_wrenches": {f"w{i}": {"frame": "l1"} for i in range(1001)}},
            "external_wrenches: 1001 entries, accepted are 1000",
        ),
        (
            {"couplings": {"j2": {"parent": JOINT, "polynomial": [0.0] * 150_000}}},
            "couplings.j2: a polynomial has 150000 coefficients, accepted are 1000",
        ),
        ({"text": "a: [" + "{}," * 300_000 + "]"}, "line 1: more than 200000 values"),
    ],
)
def test_a_scene_too_large_is_refused_with_its_number(scene, capsys, sections, told):
    path = scene(**sections)
    assert cli.main(["check", path]) == 2
    assert f"{path}: {told}" in capsys.readouterr().err


def test_a_scene_of_the_accepted_size_is_checked(scene):
    springs = [SPRING] * 1000
    path = scene(constraints=[STOP] * 600, forces=springs)
    assert cli.main(["check", path]) == 0


def test_a_spline_of_many_points_costs_their_number(scene):
    """By a dense matrix it took 12 GiB."""
    x = np.linspace(-3.0, 3.0, 40_001)
    value, slope, curvature = natural_cubic_spline(x.tolist(), np.sin(x).tolist())(0.5)
    assert value == pytest.approx(np.sin(0.5), abs=1e-14)
    assert slope == pytest.approx(np.cos(0.5), abs=1e-10)
    assert curvature == pytest.approx(-np.sin(0.5), abs=1e-5)  # O(h^2) of 1.5e-4, and rounding


def test_the_longest_accepted_chain_is_checked_in_two_gigabytes(tmp_path):
    """Two Data of Pinocchio at a time, 32 nv^3 bytes each; it had four, and copied each."""
    links = "".join(
        f"<link name='l{i}'><inertial><mass value='1'/><inertia ixx='.02' iyy='.02' izz='.01' "
        f"ixy='0' ixz='0' iyz='0'/></inertial></link><joint name='j{i}' type='continuous'><parent "
        f"link='l{i - 1}'/><child link='l{i}'/><origin xyz='0 0 0.1'/></joint>"
        for i in range(1, MAX_JOINTS + 1)
    )
    (tmp_path / "r.urdf").write_text(f"<robot name='r'><link name='l0'/>{links}</robot>")
    (tmp_path / "s.yaml").write_text("robot: {urdf: r.urdf}")
    program = f"from mbd_ros import cli; cli.main(['check', '{tmp_path / 's.yaml'}'])"
    said, peak = in_a_process(program)
    assert "degrees of freedom 300" in said
    assert peak < 2.0 * 1024**2


def test_columns_lines_and_numbers_of_a_table_have_limits(tmp_path, monkeypatch):
    wide = tmp_path / "wide.csv"
    wide.write_text(",".join(("time", *(f"c{i}" for i in range(30_000)))) + "\n")
    with pytest.raises(DataError, match=r"wide\.csv: 30001 columns, accepted are 10000"):
        read_table(wide)
    wide.write_text("time,a\n" + "0" * 2_000_000)
    with pytest.raises(DataError, match="line 2 has more than 1000000 bytes"):
        read_table(wide)
    monkeypatch.setattr("mbd_ros.files.tables.csv.MAX_CELLS", 100_000)
    write_table(wide, ["time", "a"], np.arange(120_000.0).reshape(-1, 2))
    with pytest.raises(DataError, match="more than 100000 numbers are not accepted"):
        read_table(wide)
    assert MAX_CELLS == 100_000_000


@pytest.mark.parametrize("line", [b"0", b"0,0\n", b"1e0,1\n"])
def test_a_gzip_bomb_is_refused_from_its_first_lines(tmp_path, line):
    """256 MiB from 250 KiB: they are never all in memory, nor unpacked to the end."""
    path = tmp_path / "bomb.csv.gz"
    with gzip.open(path, "wb", compresslevel=9) as file:
        file.write(b"time,a\n")
        for _ in range(256):
            file.write(line * (2**20 // len(line)))
    told, peak = in_a_process(
        "from mbd_ros.files.tables.csv import read_table, DataError\n"
        f"try: read_table('{path}')\nexcept DataError as error: print(error)"
    )
    assert "line 2 has more than" in told or "line 3, column time" in told
    assert peak < 150 * 1024


@pytest.mark.parametrize("kind", ["fifo", "zero", "loop", "long", "null", "folder"])
def test_what_is_no_file_is_refused_at_once(scene, tmp_path, capsys, kind):
    path = tmp_path / ("m" * 300 if kind == "long" else "m\0" if kind == "null" else "m") / "x.csv"
    if kind not in ("long", "null"):
        path = tmp_path / "x.csv"
    {
        "fifo": lambda: os.mkfifo(path),
        "zero": lambda: path.symlink_to("/dev/zero"),
        "loop": lambda: path.symlink_to(path),
        "folder": path.mkdir,
    }.get(kind, lambda: None)()
    words = ["inverse", scene(), str(path), "-o", str(tmp_path / "o.csv")]
    try:
        code = cli.main(words)
    except SystemExit as end:  # a name that cannot be is refused with the words
        code = end.code
    told = capsys.readouterr().err
    assert code == 2
    assert "Traceback" not in told
    assert "cannot be" in told or "not a rosbag2 folder" in told
    assert not (tmp_path / "o.csv").exists()


@pytest.mark.parametrize("which", ["scene", "urdf", "out"])
@pytest.mark.parametrize("kind", ["loop", "long"])
def test_names_that_no_file_can_have_are_clear_errors(scene, tmp_path, capsys, which, kind):
    bad = "z" * 5000 if kind == "long" else "loop"
    (tmp_path / "loop").symlink_to("loop")
    text = json.dumps({"robot": {"urdf": bad}}) if which == "urdf" else None
    words = ["simulate", scene(text), "-t", "0.01", "-o", str(tmp_path / "o.csv")]
    if which != "urdf":
        words[{"scene": 1, "out": 5}[which]] = str(tmp_path / bad)
    try:
        code = cli.main(words)
    except SystemExit as end:
        code = end.code
    told = capsys.readouterr().err
    assert code == 2
    assert "File name too long" in told or "loop" in told.lower() or "symbolic links" in told
    assert max(map(len, told.splitlines())) <= 2000


def test_a_result_may_have_a_name_as_long_as_a_file_may_have(scene, tmp_path):
    out = tmp_path / ("o" * 251 + ".csv")
    assert cli.main(["simulate", scene(), "-t", "0.01", "-o", str(out)]) == 0
    assert out.exists()


def test_a_wide_motion_behaves():
    motion = tables.table(random.Random(1), tuple(f"j{i}" for i in range(2400)), rows=2)
    files = {"s.yaml": b"robot: {urdf: r.urdf}", "r.urdf": ROBOT.text.encode(), "m.csv": motion}
    words = ("inverse", "@s.yaml", "@m.csv", "-o", "@o.csv")
    behaves(Case(words, files, "o.csv"))
