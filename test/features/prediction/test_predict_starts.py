"""Several starts of a prediction, here and on workers."""

import numpy as np
import pytest

import mbd_ros as mbd
from mbd_ros.cli import main
from mbd_ros.errors import OK, DataError
from mbd_ros.files.table import read_result

TASK = """
predict:
  duration: 2.0
  start: {"*.position": 0.0, "*.velocity": 0.0}
  end: {cart.position: 1.0, pole.position: 3.141592653589793, "*.velocity": 0.0}
  goals: [{type: effort}]
  tolerance: 1.0e-2
  starts: 3
"""


def test_starts_on_workers_are_those_of_one_process(tmp_path, capsys):
    """The same bits, whoever tried them; the cheapest solution is the result."""
    (tmp_path / "task.yaml").write_text(TASK)
    found = []
    for workers in ("1", "2"):
        out = tmp_path / f"{workers}.npz"
        words = ["predict", "cart_pole", str(tmp_path / "task.yaml"), "-o", str(out)]
        assert main([*words, "--workers", workers]) == OK
        found.append(read_result(out))
    assert "the best is start" in capsys.readouterr().out
    one, other = found
    starts = one["starts"]
    for name in starts:
        np.testing.assert_allclose(other["starts"][name], starts[name], rtol=1.0e-9, err_msg=name)
    for name in one["samples"]:
        np.testing.assert_array_equal(other["samples"][name], one["samples"][name], err_msg=name)
    assert starts["start"].tolist() == [1.0, 2.0, 3.0]
    best = starts["cost"][starts["converged"] == 1.0].min()
    assert one.metadata["cost"] == pytest.approx(best, rel=1.0e-7)


@pytest.mark.soak
def test_starts_on_a_cluster_are_those_of_one_process(tmp_path):
    """Behind the address of a scheduler of Dask with two workers, from the command line."""
    distributed = pytest.importorskip("distributed", reason="pip install 'mbd_ros[dask]'")
    (tmp_path / "task.yaml").write_text(TASK)
    out, words = tmp_path / "here.npz", ["predict", "cart_pole", str(tmp_path / "task.yaml"), "-o"]
    assert main([*words, str(out)]) == OK
    found = [read_result(out)]
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0"}
    with distributed.LocalCluster(**options, silence_logs=50) as cluster:
        out = tmp_path / "there.npz"
        assert main([*words, str(out), "--scheduler", cluster.scheduler_address]) == OK
    found.append(read_result(out))
    for table in ("samples", "starts"):
        here, there = (one[table] for one in found)
        for name in here:
            np.testing.assert_allclose(there[name], here[name], rtol=1.0e-9, err_msg=name)


def test_a_scene_that_is_no_file_stays_here():
    scene = mbd.load_scene("cart_pole").with_(dt=2.0e-3)
    task = {"duration": 2.0, "goals": [{"type": "effort"}], "starts": 2}
    with pytest.raises(DataError, match="from a file"):
        scene.predict(task, workers=2)
