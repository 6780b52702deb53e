"""What several test files need."""

import gc
import os
import shutil
import signal
from pathlib import Path

import pytest
from crashes import pytest_configure, pytest_handlecrashitem, pytest_unconfigure  # noqa: F401
from places import ROOT

os.environ.setdefault("OMP_NUM_THREADS", "1")  # as the command line does, before OpenMP is loaded
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # what shells do to background jobs
    signal.signal(signal.SIGINT, signal.default_int_handler)  # processes of tests inherit it

CHROMIUM = ("chromium", "chromium-browser", "google-chrome")
SCREENSHOTS = ROOT / "build" / "screenshots"

gc.disable()  # thousands of tests are made and kept: looking for garbage among them takes longer


def pytest_collection_finish():
    """What is loaded by now is no garbage: tests that collect garbage need not look at it."""
    gc.collect()
    gc.freeze()
    gc.enable()


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
    """Folder of the data of others that `test/data` does not hold."""
    beside = ROOT.parent / "shared" / "data"
    folder = Path(os.environ.get("MBD_ROS_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no data of others at {folder}: set MBD_ROS_DATA")
    return folder


@pytest.fixture(scope="session")
def browser():
    """Chromium with software rendering, driven by Playwright; skipped where either is missing."""
    found = next(filter(None, map(shutil.which, CHROMIUM)), None)
    if found is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    with playwright.sync_playwright() as started:
        words = ["--no-sandbox", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist"]
        opened = started.chromium.launch(executable_path=found, args=words)
        yield opened
        opened.close()


@pytest.fixture
def screenshot():
    """Keeps what a tab shows as build/screenshots/NAME.png, to be looked at."""

    def keep(tab, name):
        SCREENSHOTS.mkdir(parents=True, exist_ok=True)
        tab.screenshot(path=SCREENSHOTS / f"{name}.png")

    return keep
