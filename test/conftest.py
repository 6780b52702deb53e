"""What several test files need."""

import gc
import os
import signal
from pathlib import Path

import pytest

os.environ.setdefault("OMP_NUM_THREADS", "1")  # as the command line does, before OpenMP is loaded
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # what shells do to background jobs
    signal.signal(signal.SIGINT, signal.default_int_handler)  # processes of tests inherit it


def pytest_collection_finish():
    """What is loaded by now is no garbage: tests that collect garbage need not look at it."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def cache_of_the_run(tmp_path_factory):
    """One cache folder for all workers and processes of a run, empty at its beginning.

    What one test compiles serves the next one, and nothing of the user's cache is used.
    """
    base = tmp_path_factory.getbasetemp()
    root = base.parent if "PYTEST_XDIST_WORKER" in os.environ else base
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(root / "cache"))
        yield


@pytest.fixture(scope="session")
def data_dir():
    """Folder of the recorded data, which is no part of the package."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("MBD_ROS_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no recorded data at {folder}: set MBD_ROS_DATA")
    return folder
