"""Laws and chains of dependent joints against SciPy, finite differences and constraint rows."""

import numpy as np
import pytest
from places import ROOT
from scipy.interpolate import CubicSpline, PPoly

from mbd_ros.core.model.coupling_functions import (
    Harmonic,
    PiecewisePolynomial,
    Polynomial,
    natural_cubic_spline,
    simm_spline,
)
from mbd_ros.core.model.couplings import Coupling, Couplings
from mbd_ros.core.model.robot_reader import read_robot
from mbd_ros.errors import ModelError

ARM = (ROOT / "config/robots/arm7.urdf").read_text(encoding="utf-8")
X, Y = [-2.0, -1.1, -0.3, 0.4, 1.9], [0.4, -0.2, 0.1, 0.3, -0.5]
BREAKS, ROWS = [-1.0, 0.2, 1.0], [[0.3, -0.2, 0.5, 0.1], [-0.7, 0.1, 0.2, 0.4]]
# joint2 <- joint1 <- joint6 <- joint3, two of the parents further out on the arm; joint4 <- joint5
CHAIN = {
    "joint2": Coupling("joint1", Polynomial([0.2, -0.4, 0.3, 0.1])),
    "joint1": Coupling("joint6", natural_cubic_spline(X, Y)),
    "joint6": Coupling("joint3", Polynomial([0.0, 0.7, 0.2])),
    "joint4": Coupling("joint5", Polynomial([0.3, -1.5])),
}
INSIDE = np.linspace(-1.99, 1.89, 98)


def with_mimic(text, joint, parent, rest=""):
    head, tail = text.split(f'<joint name="{joint}" type="revolute">')
    return f'{head}<joint name="{joint}" type="revolute"><mimic joint="{parent}" {rest}/>{tail}'


def scipy_law(kind):
    """Ours and SciPy's version of one law."""
    if kind == "spline":
        return natural_cubic_spline(X, Y), CubicSpline(X, Y, bc_type="natural")
    if kind == "piecewise":
        return PiecewisePolynomial(BREAKS, ROWS), PPoly(np.transpose(ROWS), BREAKS)
    return Polynomial([0.3, 0.0, -1.0, 2.0]), PPoly([[2.0], [-1.0], [0.0], [0.3]], [0.0, 1.0])


@pytest.mark.parametrize("kind", ["spline", "piecewise", "polynomial"])
def test_law_equals_scipys_for_floats_and_arrays(kind):
    """Value, slope and curvature; also outside where SciPy continues the outer piece alike."""
    ours, theirs = scipy_law(kind)
    z = INSIDE if kind == "spline" else np.r_[INSIDE, -7.0, 5.0, BREAKS]
    expected = [theirs(z, order) for order in range(3)]
    assert np.array(ours(z)) == pytest.approx(np.array(expected), abs=1e-12)
    one_by_one = np.transpose([ours(float(x)) for x in z])
    assert np.array_equal(one_by_one, np.array(ours(z)))


def test_spline_passes_its_knots_and_continues_as_straight_lines():
    law, reference = natural_cubic_spline(X, Y), CubicSpline(X, Y, bc_type="natural")
    assert np.array([law(x)[0] for x in X]) == pytest.approx(np.array(Y), abs=1e-14)
    for end, outside in ((X[0], -3.5), (X[-1], 44.0)):
        slope = float(reference(end, 1))
        expected = float(reference(end)) + slope * (outside - end), slope, 0.0
        assert law(outside) == pytest.approx(expected, abs=1e-12)
        below, above = law(end - 1e-9), law(end + 1e-9)
        assert below == pytest.approx(above, abs=1e-7)
    line = natural_cubic_spline([1.0, 3.0], [0.0, 1.0])
    assert np.array(line(np.array([0.0, 2.0, 9.0]))) == pytest.approx(
        np.array([[-0.5, 0.5, 4.0], [0.5] * 3, [0.0] * 3])
    )


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Polynomial([]), "a polynomial needs at least one"),
        (lambda: natural_cubic_spline([0.0, 1.0], [0.0]), "spline has 2 values of x and 1 of y"),
        (lambda: natural_cubic_spline([0.0], [0.0]), "x must be at least two increasing"),
        (lambda: natural_cubic_spline([0.0, 0.0], [0.0, 1.0]), "increasing numbers, got"),
        (lambda: PiecewisePolynomial([1.0, 0.0], [[1.0]]), "breaks must be at least two incr"),
        (lambda: PiecewisePolynomial([0.0, 1.0], []), "coefficients have 0 rows, but there are 1"),
        (lambda: PiecewisePolynomial([0.0, 1.0], [[]]), "must have the same length"),
        (lambda: PiecewisePolynomial(BREAKS, [[1.0], [1.0, 2.0]]), "must have the same length"),
    ],
)
def test_law_that_makes_no_sense_is_refused(build, message):
    with pytest.raises(ModelError) as caught:
        build()
    assert message in str(caught.value)


def trajectory(t, order):
    """Independent positions (joint3, joint5, joint7) or their derivatives in time."""
    w, phase, size = np.array([2.1, 1.3, 3.0]), np.array([0.1, 0.8, 2.0]), np.array([0.9, 1, 0.5])
    return size * w**order * np.sin(w * t + phase + order * np.pi / 2)


def expanded(couplings, t):
    q, v, a = np.full((3, 7), np.nan)
    for row, order in ((q, 0), (v, 1), (a, 2)):
        row[couplings.q_index] = trajectory(t, order)
    couplings.expand(q, v, a)
    return q, v, a


def test_velocity_and_acceleration_are_the_derivatives_in_time():
    """Central differences of fourth order, step 2 ms: truncation is below 1e-8."""
    couplings, h = Couplings(read_robot(ARM), CHAIN), 2e-3
    assert couplings.independent == ("joint3", "joint5", "joint7")
    for t in np.linspace(0.0, 1.0, 23):
        before2, before, after, after2 = (expanded(couplings, t + k * h) for k in (-2, -1, 1, 2))
        _, v, a = expanded(couplings, t)
        for i, exact in ((0, v), (1, a)):
            slope = (before2[i] - 8 * before[i] + 8 * after[i] - after2[i]) / (12 * h)
            assert slope == pytest.approx(exact, abs=1e-7)


def test_jacobian_and_drift_follow_from_each_other():
    """v = G z', a = G z'' + dG/dt z', and the columns of G by differences of F."""
    couplings, h = Couplings(read_robot(ARM), CHAIN), 1e-6
    q, v, a = expanded(couplings, 0.3)
    G = couplings.jacobian(q)
    z, rate, push = (trajectory(0.3, order) for order in range(3))
    assert np.array_equal(couplings.positions(z), q)
    assert G @ rate == pytest.approx(v, abs=1e-14)
    columns = [
        (couplings.positions(z + step) - couplings.positions(z - step)) / (2 * h)
        for step in h * np.eye(3)
    ]
    assert np.column_stack(columns) == pytest.approx(G, abs=1e-9)
    turned = []
    for sign in (1, -1):
        turned.append(couplings.jacobian(couplings.positions(z + sign * h * rate)))
    drift = (turned[0] - turned[1]) / (2 * h) @ rate
    assert G @ push + drift == pytest.approx(a, abs=1e-8)


def test_reduction_is_the_transpose_and_multipliers_balance_the_constraint_rows():
    """tau = B tau_z + Jc' lam with rows d: +1, direct parent: -f', for chains of three."""
    robot = read_robot(ARM)
    couplings = Couplings(robot, CHAIN)
    q, _, _ = expanded(couplings, 0.7)
    slopes = couplings.expand(q, np.zeros(7), np.zeros(7))
    tau = np.random.default_rng(5).normal(size=7)
    reduced, lam = couplings.reduce(tau.copy(), slopes)
    assert reduced == pytest.approx(couplings.jacobian(q).T @ tau, abs=1e-14)
    Jc = np.zeros((4, 7))
    for row, name in enumerate(couplings.dependent):
        parent = robot.joint(couplings.parents[name])
        Jc[row, robot.joint(name).v] = 1.0
        Jc[row, parent.v] = -CHAIN[name].function(float(q[parent.q]))[1]
    B = np.eye(7)[:, couplings.v_index]
    assert B @ reduced + Jc.T @ lam == pytest.approx(tau, abs=1e-14)


def test_mimic_joins_in_and_the_scene_wins():
    text = with_mimic(ARM, "joint6", "joint3", 'multiplier="2" offset="-0.1"')
    text = with_mimic(text, "joint2", "joint6")
    couplings = Couplings(read_robot(text, rename={"joint3": "elbow"}))
    assert couplings.parents == {"joint6": "elbow", "joint2": "joint6"}
    q = couplings.positions(np.array([0.0, 0.4, 0.0, 0.0, 0.0]))
    assert (q[5], q[1]) == pytest.approx((0.7, 0.7))
    won = Couplings(read_robot(text), {"joint2": Coupling("joint5", Polynomial([0.0, 3.0]))})
    assert won.parents == {"joint6": "joint3", "joint2": "joint5"}
    locked = Couplings(read_robot(text, locked={"joint6": 0.5, "joint2": 0.0}))
    assert locked.dependent == ()


@pytest.mark.parametrize(
    ("pairs", "message"),
    [
        ("1<1", "couplings form a cycle: joint1 <- joint1"),
        ("1<2 2<3 3<1", "couplings form a cycle: joint1 <- joint2 <- joint3 <- joint1"),
        ("5<1 1<2 2<1", "couplings form a cycle: joint5 <- joint1 <- joint2 <- joint1"),
        ("1<9", "coupling joint1 <- joint9: parent: no joint 'joint9'; the robot has joint1, "),
        ("9<1", "coupling joint9 <- joint1: coupled joint: no joint 'joint9'"),
        ("1<7", "coupling joint1 <- joint7: parent: joint 'joint7' is locked at 0.2"),
        ("7<1", "coupling joint7 <- joint1: coupled joint: joint 'joint7' is locked at 0.2"),
        ("1<0", "coupling joint1 <- joint0: parent: joint 'joint0' is fixed"),
        ("0<1", "coupling joint0 <- joint1: coupled joint: joint 'joint0' is fixed"),
    ],
)
def test_coupling_that_cannot_be_is_refused_with_its_path(pairs, message):
    fixed = '<link name="x"/><joint name="joint0" type="fixed"><parent link="base"/>'
    text = ARM.replace("</robot>", fixed + '<child link="x"/></joint></robot>')
    robot = read_robot(text, locked={"joint7": 0.2})
    laws = {
        f"joint{child}": Coupling(f"joint{parent}", Polynomial([0.0, 1.0]))
        for child, parent in (pair.split("<") for pair in pairs.split())
    }
    with pytest.raises(ModelError) as caught:
        Couplings(robot, laws)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("parent", "rest", "message"),
    [
        ("joint9", "", "joint 'joint6': mimic of unknown joint 'joint9'"),
        ("joint3", 'multiplier="0"', "joint 'joint6': mimic multiplier is 0; lock the joint"),
        ("joint3", 'offset="nan"', "joint 'joint6': <mimic offset='nan'>"),
    ],
)
def test_mimic_that_cannot_be_is_refused(parent, rest, message):
    with pytest.raises(ModelError) as caught:
        read_robot(with_mimic(ARM, "joint6", parent, rest))
    assert message in str(caught.value)


def test_the_spline_of_simm_is_a_cubic_through_points_of_one():
    """Its end pieces have the third derivatives of the data; it goes on straight beyond them."""
    cubic = np.polynomial.Polynomial([0.3, -1.0, 0.5, 0.8])
    x = np.array([-1.0, -0.4, 0.1, 0.9, 1.3])
    spline, z = simm_spline(x, cubic(x)), np.linspace(-1.0, 1.29, 40)
    for found, expected in zip(
        spline(z), (cubic(z), cubic.deriv()(z), cubic.deriv(2)(z)), strict=True
    ):
        assert found == pytest.approx(expected, abs=1e-13)
    beyond = cubic(1.3) + 0.5 * cubic.deriv()(1.3)
    assert spline(1.8)[0] == pytest.approx(beyond, abs=1e-13)
    assert spline(1.8)[2] == 0.0


def test_a_harmonic_has_its_slope_and_curvature():
    law, z, h = Harmonic(0.4, 3.0, 0.2, -0.1), np.linspace(-2.0, 2.0, 9), 1e-5
    value, slope, curvature = law(z)
    assert value == pytest.approx(-0.1 + 0.4 * np.sin(3.0 * z + 0.2), abs=1e-15)
    assert slope == pytest.approx((law(z + h)[0] - law(z - h)[0]) / (2.0 * h), abs=1e-8)
    assert curvature == pytest.approx((law(z + h)[1] - law(z - h)[1]) / (2.0 * h), abs=1e-8)
    assert law(0.7) == pytest.approx([row.item() for row in law(np.array([0.7]))], abs=1e-15)
