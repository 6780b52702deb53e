"""`mbd-ros sample`: the command, its files, workers, components, and bad input."""

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import DataError

TRIMER = "particles/trimer"
SMALL = {"temperature": 1.0, "chains": 8, "samples": 20, "warmup": 10, "components": False}


def run(capsys, *words):
    """Exit code, what was said, and the error."""
    code = main(["sample", *map(str, words)])
    said = capsys.readouterr()
    return code, said.out, said.err


def test_same_bits_on_any_number_of_workers():
    scene = mbd.load_scene(TRIMER)
    alone, many = (scene.sample(SMALL, workers=n) for n in (1, 2))
    assert alone["samples"] == many["samples"]
    other = scene.sample({**SMALL, "seed": 1}, workers=1)
    assert alone["samples"] != other["samples"]


@pytest.mark.parametrize("method", ["metropolis", "langevin"])
def test_a_checkpoint_goes_on_with_the_same_bits(method, tmp_path):
    scene, path = mbd.load_scene(TRIMER), tmp_path / "chains.npz"
    asked = {**SMALL, "method": method}
    scene.sample(asked, workers=1, checkpoint=path)
    second = scene.sample(asked, workers=1, goes_on=path)["samples"]["cosine_A_B_C"]
    whole = scene.sample({**asked, "samples": 40}, workers=1)["samples"]["cosine_A_B_C"]
    assert (whole.reshape(8, 40)[:, 20:] == second.reshape(8, 20)).all()
    with pytest.raises(mbd.MbdError, match="9 coordinates of 4 chains, this run has 9 of 3"):
        scene.sample({**SMALL, "chains": 6}, workers=1, goes_on=path)


@pytest.mark.parametrize(
    ("scene", "said"),
    [
        (
            "particles/ring_of_two_branches",
            "components: 2 that no motion along the constraints joins",
        ),
        ("particles/ring_of_one_branch", "components: 1, from"),
        pytest.param("four_bar_leg", "components: 2", marks=pytest.mark.soak),
    ],
)
def test_components_of_closed_chains(scene, said):
    """Grashof's law: 1 + 2 < 2 + 2 has two branches, 4 + 1 > 2 + 2 has one."""
    asked = {**SMALL, "components": True, "chains": 2, "samples": 8, "warmup": 2, "steps": 1}
    del asked["temperature"]
    lines = mbd.load_scene(scene).sample({**asked, "thermal_energy": 1.0}, workers=1).metadata
    assert any(line.startswith(said) for line in lines["remarks"]), lines["remarks"]
    walls = [line for line in lines["remarks"] if "wall" in line]
    assert bool(walls) is ("2" in said)


def test_a_run_with_all_its_files(tmp_path, capsys):
    task = tmp_path / "task.yaml"
    task.write_text(
        "sample:\n  temperature: 1.0\n  chains: 8\n  samples: 20\n  warmup: 5\n"
        "  observe: {bend: angle A B C, ends: distance A C}\n"
        "  histograms: {ends: [0.0, 2.0, 4]}\n",
        encoding="utf-8",
    )
    out, plot = tmp_path / "o.csv", tmp_path / "o.svg"
    words = (TRIMER, task, "-o", out, "--plot", plot, "--workers", 1, "--seed", 3)
    code, said, error = run(capsys, *words)
    assert (code, error) == (0, "")
    assert "7 degrees of freedom" in said
    samples = np.genfromtxt(out, delimiter=",", names=True)
    assert samples["chain"].tolist() == [float(c) for c in range(1, 9) for _ in range(20)]
    ends = 2.0 * np.sin(samples["bend"] / 2.0)
    assert samples["ends"] == pytest.approx(ends, abs=1e-12)
    bins = np.genfromtxt(tmp_path / "o.histogram.ends.csv", delimiter=",", names=True)
    assert bins["share"].sum() == pytest.approx(1.0)
    assert plot.stat().st_size > 1000


def test_a_row_as_coordinate_is_swept(capsys):
    """The row gives way; what others hold is not asked for twice."""
    words = (
        "particles/ellipse",
        "--temperature",
        1,
        "--chains",
        4,
        "--samples",
        10,
        "--warmup",
        5,
    )
    code, said, _ = run(capsys, *words, "--coordinate", "P_quadric", "--at", 0.5, 0.6)
    assert code == 0
    assert said.count("mean force") == 2
    code, _, error = run(capsys, *words, "--coordinate", "quadratic P 1 0.25 0", "--at", 0.5)
    assert code == 2
    assert "of the scene fix quadratic_P" in error


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((TRIMER,), "expected one of temperature and thermal_energy"),
        ((TRIMER, "--temperature", -1), "sample.temperature: -1 is out of range"),
        ((TRIMER, "--temperature", 0), "the temperature must be > 0"),
        ((TRIMER, "--temperature", "nan"), "sample.temperature: nan is out of range"),
        ((TRIMER, "--temperature", 1, "--chains", 1), "sample.chains: 1 is out of range"),
        ((TRIMER, "--temperature", 1, "--friction", 1), "metropolis has none"),
        ((TRIMER, "--temperature", 1, "--observe", "distance A Z"), "no particle 'Z'"),
        ((TRIMER, "--temperature", 1, "--observe", "bend A B"), "'bend A B' is not a quantity"),
        ((TRIMER, "--temperature", 1, "--coordinate", "distance A C"), "coordinate and at go"),
        ((TRIMER, "--temperature", 1, "--samples", 7), "sample.samples: 7 is out of range"),
        (
            (TRIMER, "--temperature", 1, "--coordinate", "distance A C", "--at", 1, 1),
            "expected values that rise or fall",
        ),
        (
            (TRIMER, "--temperature", 1, "--coordinate", "distance A C", "--at", 3),
            "cannot move",
        ),
        ((TRIMER, "--temperature", 1, "--continue", "none.npz"), "none.npz: cannot be read"),
        (("four_bar_leg", "--thermal-energy", 1, "--method", "langevin"), "constant masses"),
        (("free_flyer", "--thermal-energy", 1), "free body"),
        (("stack", "--thermal-energy", 1), "contacts"),
    ],
)
def test_bad_input_is_one_clear_error(words, expected, capsys):
    code, _, error = run(capsys, *words)
    assert code == 2
    assert expected in error
    assert len(error.splitlines()) == 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"q0": np.float64(1.0)}, "q0 has shape () of float64, accepted: (9, 4) of numbers"),
        ({"q0": np.ones((9, 3))}, "9 coordinates of 3 chains, this run has 9 of 4"),
        ({"v1": np.ones((9, 4), complex)}, "v1 has shape (9, 4) of complex128"),
        ({"v0": np.full((9, 4), np.inf)}, "block 1 holds numbers that are not finite"),
        ({"q0": np.full((9, 4), 1e308)}, "not finite, or beyond 1e+30"),
        ({"sweeps0": np.array([1, 2])}, "sweeps0 has shape (2,) of int64, accepted: () of whole"),
        ({"sweeps0": np.float64(3.0)}, "sweeps0 has shape () of float64, accepted: () of whole"),
        ({"sweeps1": np.int64(-1)}, "sweeps1 is -1 and dt1 is"),
        ({"dt0": np.array("x")}, "dt0 has shape () of <U1"),
        ({"dt0": np.float64(0.0)}, "and dt0 is 0.0, accepted: above 0"),
        ({"dt1": None}, "has no block 2 of 2"),
        ({"q2": np.ones(3)}, "belongs to a run with more chains"),
    ],
)
def test_a_checkpoint_whose_arrays_are_others_is_refused(changes, message, tmp_path):
    path, scene = tmp_path / "c.npz", mbd.load_scene(TRIMER)
    arrays = {f"q{i}": np.zeros((9, 4)) for i in (0, 1)} | {
        f"v{i}": np.zeros((9, 4)) for i in (0, 1)
    }
    arrays |= {"sweeps0": np.int64(9), "sweeps1": np.int64(9), "dt0": 0.1, "dt1": 0.1} | changes
    np.savez(path, **{key: array for key, array in arrays.items() if array is not None})
    with pytest.raises(DataError) as refused:
        scene.sample(SMALL, workers=1, goes_on=path)
    assert str(refused.value).startswith(f"{path}: ")
    assert message in str(refused.value)
