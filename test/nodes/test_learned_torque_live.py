"""A learned torque in the node `inverse_dynamics`: 500 Hz, its torques, its diagnostics."""

import time

import numpy as np
import pytest
from learned_torque import content
from nodes.joint_stream import live

import mbd_ros as mbd
from msg_adapters.diagnostics import WARN

pytest.importorskip("onnx", reason="onnx is optional (extra: learn)")
pytest.importorskip("onnxruntime", reason="onnxruntime is optional (extra: learned)")
COUNT, PERIOD = 600, 0.002  # s


def test_500_hz_with_a_structured_model_and_a_warning_beyond_its_range(domain, tmp_path):
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
        begun, busy = time.perf_counter(), stream.node.cpu_seconds()
        for k in range(3, COUNT):
            stream.send(k)
            due = begun + (k - 2) * PERIOD
            stream.probe.spin_for(max(due - time.perf_counter(), 0.0))
        stream.answers(COUNT)
        assert stream.node.cpu_seconds() - busy < 0.8 * (COUNT - 3) * PERIOD
        for k in np.arange(3, COUNT, 50):
            stream.check(stream.torques[k], int(k))
        seen = len(stream.probe.health)
        for k in range(COUNT, COUNT + 300):  # diagnostics of a stream that goes on
            stream.send(k)
            stream.probe.spin_for(0.01)
            said = [h for h in stream.probe.health[seen:] if h.name == stream.name]
            if any(h.level == WARN for h in said):
                break
        assert "position of joint7 is outside of what was learned from" in said[-1].message
