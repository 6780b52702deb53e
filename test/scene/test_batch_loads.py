"""External loads of many samples at once act as those of one sample at a time."""

import numpy as np
import pytest

from mbd_ros import scene_from
from mbd_ros.core.model.couplings import IndependentCoordinates

LOADS = {
    "hand": {"frame": "link7", "expressed_in": "world", "point": [0.1, -0.2, 0.3]},
    "elbow": {"frame": "link4"},
    "held": {"frame": "link2", "expressed_in": "link6", "point": [0.0, 0.1, 0.0]},
    "plate": {"frame": "link5", "expressed_in": "world", "threshold": 1.0},
    "ground": {"frame": "world", "expressed_in": "world"},
}
FORCES = [
    {"type": "applied_wrench", "frame": "link5", "force": [3.0, -2.0, 9.0], "torque": [1.0, 0, 2]},
    {"type": "joint_spring", "joint": "joint3", "stiffness": 40.0, "damping": 2.0},
]
COUPLED = {"joint6": {"parent": "joint2", "polynomial": [0.1, 0.4, 0.2]}}


@pytest.mark.parametrize("base", ["fixed", "floating"])
@pytest.mark.parametrize("couplings", [{}, COUPLED])
@pytest.mark.parametrize("forces", [[], FORCES])
def test_a_batch_equals_its_samples(base, couplings, forces):
    """Both by Pinocchio, one load by one load through `rnea`, or all through world Jacobians."""
    entries = {"robot": {"base": base}, "external_wrenches": LOADS}
    if forces:
        entries["forces"] = forces
    if couplings:
        entries["couplings"] = couplings
    scene = scene_from(entries, urdf="arm7")
    solver, n, rng = scene.inverse_dynamics(), 300, np.random.default_rng(11)
    at = IndependentCoordinates(scene.robot, scene.couplings)
    y = rng.standard_normal((n, len(scene.couplings.q_index)))
    for where in at.body_y:
        turn = np.arange(y.shape[1])[where][3:]
        y[:, turn] /= np.linalg.norm(y[:, turn], axis=1)[:, None]
    v, a = rng.standard_normal((2, n, len(scene.couplings.v_index)))
    wrenches = [rng.standard_normal((n, 6)) * 2.0 for _ in LOADS]
    found = solver.batch(y, v, a, wrenches)
    for i in range(0, n, 7):
        one = solver.solve(y[i], v[i], a[i], [w[i] for w in wrenches])
        assert found.tau[i] == pytest.approx(one.tau, rel=1e-11, abs=1e-11)
        assert found.multipliers[i] == pytest.approx(one.multipliers, rel=1e-11, abs=1e-11)
    unloaded = solver.batch(y, v, a)
    assert np.abs(found.tau - unloaded.tau).max() > 1.0
