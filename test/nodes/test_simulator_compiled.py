"""A simulator whose ticks run in native code, over DDS."""

import numpy as np
import pytest
from nodes.simulation_client import ARM, DAMPED, simulated, swinging

from mbd_ros.api import load_scene
from mbd_ros.core.loads.inputs import HeldTable

TICK, COUNT = 2e-3, 60
TIMES = TICK * np.arange(COUNT)
COMMANDS = np.array([10.0 * swinging(t) for t in TIMES])
ELBOW = 2  # of the joints: it is coupled
STOP = "constraints: [{type: joint_stop, joint: shoulder_abduction, upper: 0.03}]\n"


def offline(path, solver):
    """Positions and velocities at every tick of a run in this process, and its events."""
    scene = load_scene(path)
    sources = {"ideal": HeldTable(TIMES, COMMANDS)}
    simulation = scene.simulation(solver={"type": solver}, sources=sources)
    states = list(simulation.run(scene.initial, COUNT * TICK))
    return np.array([(x.q, x.v) for x in states])[1:], len(simulation.events)


@pytest.mark.parametrize("impacts", [0, 1])
def test_ticks_are_the_samples_of_offline_runs(domain, tmp_path, impacts):
    """Under a command of each tick; once a stop is met on the way."""
    text = f"{ARM}{DAMPED}{impacts * STOP}dt: {TICK}\n"
    (path := tmp_path / "local.yaml").write_text(text, encoding="utf-8")
    options = {"compiled": "true", "paused": "true", "safe_ramp": 0.0, "rate": 1 / TICK}
    live = []
    with simulated(domain, tmp_path, text, **options) as client:
        for command in COMMANDS:
            client.command(command)
            sample = client.step()
            live.append((sample.position, sample.velocity))
        client.node.wait_for("compiling")
    (plain, events), (compiled, same) = (offline(path, kind) for kind in ("plain", "compiled"))
    assert (events, same) == (impacts, impacts)
    assert np.abs(live - plain).max() < 1e-9
    assert np.array_equal(np.delete(live, ELBOW, 2), np.delete(compiled, ELBOW, 2))
    assert np.abs(live - compiled).max() < 1e-15  # the elbow's law is fused in native code
