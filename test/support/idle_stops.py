"""Cases that several tests share: idle stops."""

import sys

import numpy as np

START = np.random.default_rng(2).uniform(-0.5, 0.5, (2, 7))


def stepping(simulation, x):
    """A function that takes a step."""
    state = [x]

    def step():
        state[0] = simulation.stepper.step(state[0], None)

    for _ in range(20):
        step()
    return step


def calls(step):
    """Calls of functions that a step makes, a few hundred steps long."""
    count = [0]

    def seen(frame, event, argument):
        count[0] += event in ("call", "c_call")

    sys.setprofile(seen)
    try:
        for _ in range(300):
            step()
    finally:
        sys.setprofile(None)
    return count[0] / 300
