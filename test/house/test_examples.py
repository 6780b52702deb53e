"""The scripts in examples/ run as a user runs them, from an empty folder."""

import re
import subprocess
import sys

import pytest
from places import ROOT

EXAMPLES = ROOT / "examples"
SAYS = {  # script -> what it says in the end
    "constraint": r"force in the belt: [1-9][\d.]* N m\nlargest slip: \d\.\de[-+](00|1\d) rad\n$",
    "control_law": r"after 2 s: \d\.\de-0[6-9] rad from the goal\n$",
    "coupled_arm": r"carries up to ([\d.]+) N m\na motor would have to give \1 N m\n$",
    "four_bar": r"largest violation of the loop: \d\.\de-1\d m\n$",
    "pylon_stress": r"(largest stress: [1-9][\d.]* MPa -> pylon\.png|pylon\.inp waits for it)\n$",
    "sweep_on_dask": r"damping 0\.00 N m s/rad: 1\.000 rad\n(damping .* 0\.\d+ rad\n){3}$",
    "torques_of_a_bag": r"(\w+\.effort \[N·m\]: up to [\d.e-]+\n){4}$",
}
LEAVES = {"four_bar": "knee.png", "torques_of_a_bag": "torques.csv"}


def test_every_example_is_among_them():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == SAYS.keys()


@pytest.mark.parametrize("name", SAYS)
def test_an_example_runs(name, tmp_path):
    ran = subprocess.run(
        [sys.executable, EXAMPLES / f"{name}.py"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert ran.returncode == 0, ran.stderr
    assert re.search(SAYS[name], ran.stdout), ran.stdout
    if name in LEAVES:
        assert (tmp_path / LEAVES[name]).stat().st_size > 1000
