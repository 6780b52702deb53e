"""`python -m mbd_ros.nodes NAME ..`: the executable NAME, where none is on the path."""

import sys

from mbd_ros.errors import BAD_INPUT
from mbd_ros.nodes.start import start_node
from mbd_ros.nodes.table import NODES

if __name__ == "__main__":
    name = sys.argv[1] if len(sys.argv) > 1 else ""
    if name not in NODES:
        sys.stderr.write(f"mbd_ros.nodes: no node '{name}'; accepted: {', '.join(NODES)}\n")
        sys.exit(BAD_INPUT)
    del sys.argv[0]
    sys.exit(start_node(name))
