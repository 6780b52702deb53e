"""`mbd-ros` in a process of its own, its report made of the fake part alone."""

import sys

from mbd_ros.applications.report import items
from mbd_ros.cli import main

if __name__ == "__main__":
    items.PARTS = {"fake": "report_fake_part"}
    sys.exit(main(sys.argv[1:]))
