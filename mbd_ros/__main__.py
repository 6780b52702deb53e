"""Run `mbd-ros` as `python -m mbd_ros`, for when the program is not on the path."""

import sys

from mbd_ros.programs import mbd_ros

if __name__ == "__main__":
    sys.exit(mbd_ros())
