"""Commands that come late, over DDS in slow motion: said, caught, and made safe."""

import numpy as np
import pytest
from deadline import PATIENT
from nodes.relay import REMAPPED, Relay, ended, started
from nodes.simulation_client import NAME, simulated
from places import ROOT

from msg_adapters.diagnostics import ERROR, OK
from msg_adapters.time import NANOSECONDS

pytestmark = pytest.mark.alone

SCENE = ROOT / "config/scenes/controlled_arm.yaml"
RAMP = 0.1  # s
SLOW = {"real_time_factor": 0.1, "publish_clock": "true", "marker_rate": 0.0}
NODES = {"sliding_mode_controller": 1000.0, "qp_controller": 250.0}


def controlled_by(name):
    return lambda h: h.name == f"/{name}" and "tolerable loop delay" in h.values


def seconds(text):
    return float(text.removesuffix(" s"))


@pytest.mark.parametrize("name", NODES)
def test_a_late_command_is_measured_and_one_too_late_is_made_safe(domain, tmp_path, name):
    """0.8 of the stated delay: controlling, within bounds. 1.5: safe after 0.1 s of stamps."""
    rate = NODES[name]
    scene = SCENE.read_text(encoding="utf-8").replace("../robots", str(ROOT / "config/robots"))
    (folder := tmp_path / "plant").mkdir()
    with simulated(domain, folder, scene, rate=rate, **SLOW) as plant, ended() as nodes:
        probe = plant.probe
        probe.node.destroy_publisher(plant._vectors)
        relay = Relay(probe)
        values = {"scene": SCENE, "use_sim_time": "true", "safe_ramp": RAMP, **PATIENT}
        nodes.append(started(domain, tmp_path / "controller", name, REMAPPED, **values))
        settled = probe.wait_health(
            lambda h: (
                controlled_by(name)(h)
                and h.level == OK
                and h.values["share of the safe command"] == "0"
                and h.values["loop delay"] != "not measured"
            )
        )
        tolerable = seconds(settled.values["tolerable loop delay"])
        assert tolerable >= 1.0 / rate

        relay.delay = 0.8 * tolerable
        begin = relay.stamps[-1]
        after(probe, relay, begin, 0.3)
        health = probe.wait_health(controlled_by(name))
        assert health.message == "controlling"
        assert 0.7 * tolerable <= seconds(health.values["loop delay"]) <= tolerable + 1e-9

        relay.delay = 1.5 * tolerable
        begin = relay.stamps[-1]
        relay.commands.clear()
        after(probe, relay, begin, 0.1 + RAMP + 0.1)
        late = begin + round((0.1 + RAMP) * NANOSECONDS)
        safe = [u for stamp, u in relay.commands if stamp is not None and stamp >= late]
        assert len(safe) > 0.05 * rate
        assert np.abs(safe)[:, 0].max() < 2.0  # N·m, where holding takes 8
        health = probe.wait_health(lambda h: controlled_by(name)(h) and h.level == ERROR)
        assert "the loop was lost, the command went safe: loop delay" in health.message
        assert health.values["share of the safe command"] == "1"
        assert plant.newest.stamp > late
        probe.wait_health(lambda h: h.name == NAME)


def after(probe, relay, begin, span):
    """Until stamps have gone on by so much [s]."""
    probe.spin_until(lambda: relay.stamps[-1] >= begin + round(span * NANOSECONDS))
