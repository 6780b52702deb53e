"""What several test files need."""

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def data_dir():
    """Folder of the recorded data, which is no part of the package."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("MBD_ROS_DATA", beside))
    if not folder.is_dir():
        pytest.skip(f"no recorded data at {folder}: set MBD_ROS_DATA")
    return folder
