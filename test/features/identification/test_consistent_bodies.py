"""Bodies that can exist: exact where the data are of one, on the edge where they are of none."""

import numpy as np
import pinocchio as pin
import pytest

from mbd_ros.core.model.inertial_parameters import is_consistent
from mbd_ros.features.identification.physical_consistency import fit_consistent_bodies

pytest.importorskip("clarabel", reason="clarabel is optional (extra: identification)")
GIVEN = pin.Inertia(2.0, np.array([0.05, 0.02, -0.1]), np.diag([0.02, 0.03, 0.025]))
TENSOR = np.array([[0.03, -0.004, -0.002], [-0.004, 0.02, -0.003], [-0.002, -0.003, 0.026]])
TRUE = pin.Inertia(1.4, np.array([-0.04, -0.03, 0.12]), TENSOR)  # all products of another sign


def rows(truth, seed=0, weight=1.0e5):
    """Weighted rows of random directions, and what they give of true numbers."""
    A = weight * np.random.default_rng(seed).normal(size=(60, len(truth)))
    return A, A @ truth


def test_a_body_of_any_sign_is_found_and_friction_does_not_drive():
    p = TRUE.toDynamicParameters()
    A, b = rows(np.concatenate([p, [0.3, -0.2]]))
    given = GIVEN.toDynamicParameters()[None]
    found = fit_consistent_bodies(A, b, np.eye(10), given, np.array([True, False]))
    assert found.inertial[0] == pytest.approx(p, abs=1e-6)
    assert found.friction == pytest.approx([0.3, -0.2], abs=1e-6)
    found = fit_consistent_bodies(A, b, np.eye(10), given, np.array([True, True]))
    assert found.friction[1] == pytest.approx(0.0, abs=1e-6)
    assert found.friction[0] >= 0.0
    assert is_consistent(found.inertial[0])


def test_data_of_no_body_give_one_and_nothing_else_is_nearer():
    """A negative moment: the optimum is not improved by steps towards other bodies."""
    p = GIVEN.toDynamicParameters()
    p[4] = -0.02
    A, b = rows(p)
    given = GIVEN.toDynamicParameters()[None]
    found = fit_consistent_bodies(A, b, np.eye(10), given, np.zeros(0, dtype=np.bool_)).inertial[0]
    assert is_consistent(found)

    def cost(numbers):
        return 0.5 * np.sum(np.square(A @ numbers - b))

    random, best = np.random.default_rng(1), cost(found)
    for _ in range(300):
        factor = random.normal(size=(4, 4)) * [0.2, 0.2, 0.2, 1.5]
        other = pin.Inertia(2.0, 0.1 * factor[0, :3], factor[:3, :3] @ factor[:3, :3].T * 0.5)
        step = found + random.choice([1e-3, 1e-2, 0.1]) * (other.toDynamicParameters() - found)
        if is_consistent(step):
            assert cost(step) >= best * (1.0 - 1e-6)


def test_what_the_data_do_not_tell_stays_as_given():
    p = GIVEN.toDynamicParameters()
    A = np.zeros((5, 10))
    A[:, 0] = 1.0e4
    found = fit_consistent_bodies(
        A, A[:, 0] * 3.0, np.eye(10), p[None], np.zeros(0, dtype=np.bool_)
    )
    assert found.inertial[0, 0] == pytest.approx(3.0, rel=1e-4)
    assert is_consistent(found.inertial[0])
