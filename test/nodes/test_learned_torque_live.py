"""A learned torque in the node `inverse_dynamics`: its torques, their cost, its diagnostics."""

import itertools
import time

import numpy as np
import pytest
from learned_torque import content
from nodes.joint_stream import live

import mbd_ros as mbd
from msg_adapters.diagnostics import WARN

pytest.importorskip("onnx", reason="onnx is optional (extra: learn)")
pytest.importorskip("onnxruntime", reason="onnxruntime is optional (extra: learned)")
COUNT, BLOCK = 600, 200
MARGIN = 12.0  # times the cost of a solution: a node also reads, filters, writes and sends


@pytest.mark.alone
def test_a_structured_model_costs_little_and_warns_beyond_its_range(domain, tmp_path):
    """Joint 7 starts at 0.42 rad and leaves 0.45 rad; all others stay inside."""
    arm = mbd.load_scene("arm7")
    (tmp_path / "model.onnx").write_bytes(content(arm, "structured", half=0.45))
    path = tmp_path / "arm.yaml"
    urdf = "package://mbd_ros/config/robots/arm7.urdf"
    force = "{type: learned_torque, model: model.onnx}"
    path.write_text(f"robot: {{urdf: '{urdf}'}}\nforces: [{force}]\n")
    with live(domain, tmp_path, path) as stream:
        for k in range(3):
            stream.ask(k)
        solver, still, ratios = stream.scene.inverse_dynamics(), np.zeros(7), []
        for begin in range(3, COUNT, BLOCK):
            busy = stream.node.cpu_seconds()
            for k in range(begin, begin + BLOCK):
                stream.send(k)
            stream.answers(begin + BLOCK)
            busy, begun = stream.node.cpu_seconds() - busy, time.process_time()
            for _ in range(BLOCK):
                solver.solve(stream.position(begin), stream.speed, still)
            ratios.append(busy / (time.process_time() - begun))
        assert np.median(ratios) < MARGIN, ratios
        for k in np.arange(3, COUNT, 50):
            stream.check(stream.torques[k], int(k))
        more, seen = itertools.count(COUNT + BLOCK), len(stream.probe.health)

        def warned():  # diagnostics of a stream that goes on
            stream.ask(next(more))
            said = [h for h in stream.probe.health[seen:] if h.name == stream.name]
            return [h for h in said if h.level == WARN]

        (health, *_) = stream.probe.spin_until(warned)
        assert "position of joint7 is outside of the trained range" in health.message
