"""Rows of velocities: knife edges. Positions never see them, velocities and accelerations do."""

import numpy as np
import pinocchio as pin
import pytest
from mechanisms import joint, link, rod, scene_of, urdf
from scipy.optimize import minimize

from mbd_ros.core.state import State
from mbd_ros.errors import SceneError
from mbd_ros.methods.inverse_dynamics.closed_loop import ClosedLoopInverseDynamics
from mbd_ros.methods.inverse_dynamics.efforts import joint_efforts
from mbd_ros.methods.projection.assembly import assemble, project, violation
from mbd_ros.methods.projection.state_projection import Measurement, StateProjector

MASS, LEVER = 2.0, 0.3  # the centre of mass of the sleigh is a lever ahead of its edge
ABOUT_COM = 3.0 * MASS * LEVER**2  # so that the path has a closed form
BODY = link("sleigh", MASS, (LEVER, 0.0, 0.0), (ABOUT_COM, ABOUT_COM, ABOUT_COM))
PLANAR = urdf(
    *(link("world"), link("along"), link("across"), BODY),
    joint("x", "prismatic", "world", "along", (1, 0, 0)),
    joint("y", "prismatic", "along", "across", (0, 1, 0)),
    joint("turn", "revolute", "across", "sleigh"),
)
EDGE = "{type: knife_edge, frame: sleigh, direction: [0, 2, 0]}"
SPEED, SPAN = 0.9, 1.4  # m/s, and the time before and after that of the fastest turn [s]


def sleigh(base="fixed", more="", dt=0.01):
    robot = f"robot: {{gravity: [0, 0, 0], base: {base}}}\n"
    description = urdf(BODY) if base == "floating" else PLANAR
    return scene_of(f"{robot}constraints: [{EDGE}]\ndt: {dt}\n{more}", description)


def chaplygin(t):
    """Position and heading of the edge, and their rates: the closed form with k = 1/4.

    m (u' - a w^2) = 0, (I + m a^2) w' + m a u w = 0 with u along the blade, I = 3 m a^2:
    u = V tanh s, w = V / (2 a) sech s, s = V t / (4 a).
    Source: J. Neimark, N. Fufaev, Dynamics of Nonholonomic Systems, 1972, ch. 2.
    """
    s = SPEED * t / (4.0 * LEVER)
    gd = 2.0 * np.arctan(np.tanh(0.5 * s))
    x = 4.0 * LEVER * (np.tanh(s) ** 2 - np.log(np.cosh(s)))
    y = 4.0 * LEVER * (gd - np.tanh(s) / np.cosh(s))
    heading, u, w = 2.0 * gd, SPEED * np.tanh(s), SPEED / (2.0 * LEVER) / np.cosh(s)
    return np.array((x, y, heading)), np.array((u * np.cos(heading), u * np.sin(heading), w))


def planar_start():
    return State(-SPAN, *chaplygin(-SPAN))


def floating_start():
    (x, y, heading), (vx, vy, w) = chaplygin(-SPAN)
    R = pin.exp3(np.array((0.0, 0.0, heading)))
    q = pin.SE3ToXYZQUAT(pin.SE3(R, np.array((x, y, 0.0))))
    return State(-SPAN, q, np.array((*R.T.dot((vx, vy, 0.0)), 0.0, 0.0, w)))


def place_of(robot, x):
    """Position and heading of the edge of either robot."""
    if not robot.floating:
        return x.q
    R = pin.Quaternion(x.q[3:7]).toRotationMatrix()
    turned = 2.0 * np.pi * np.round(chaplygin(x.t)[0][2] / (2.0 * np.pi))
    return np.array((x.q[0], x.q[1], np.arctan2(R[1, 0], R[0, 0]) + turned))


METHODS = {
    "dop853": ({"type": "dop853", "tolerance": 1e-12}, {"type": "projection"}),
    "dopri5": ({"type": "dopri5", "tolerance": 1e-11}, {"type": "projection"}),
    "feedback": ({"type": "dop853"}, {"type": "baumgarte", "time_constant": 0.1}),
    "alone": ({"type": "gauss_legendre", "stages": 3}, {"type": "none"}),
}


@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("base", ["fixed", "floating"])
def test_sleigh_keeps_its_energy_and_the_path_of_chaplygin(base, name):
    scene = sleigh(base)
    method, correction = METHODS[name]
    simulation = scene.simulation(integrator=method, stabilization=correction)
    start = planar_start() if base == "fixed" else floating_start()
    states = list(simulation.run(start, 2.0 * SPAN))
    energy = [simulation.system.energy(x) for x in states]
    assert energy == pytest.approx([0.5 * MASS * SPEED**2] * len(states), rel=1e-9)
    for x in states[::20]:
        left = place_of(scene.robot, x) - chaplygin(x.t)[0]
        assert np.abs((left + np.array((0, 0, np.pi))) % (2 * np.pi) - (0, 0, np.pi))[2] <= 1e-8
        assert np.abs(left[:2]).max() <= 1e-8
    assert violation(simulation.system, states[-1]).velocity <= 1e-9


def test_generalized_alpha_keeps_the_edge_and_its_order():
    errors = []
    for dt in (0.02, 0.01):
        simulation = sleigh(dt=dt).simulation(
            integrator={"type": "generalized_alpha", "tolerance": 1e-13}
        )
        *_, x = simulation.run(planar_start(), 2.0 * SPAN)
        assert violation(simulation.system, x).velocity <= 1e-12
        errors.append(np.abs(x.q - chaplygin(x.t)[0]).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2.0, abs=0.25)


@pytest.mark.parametrize("method", ["rattle", "shake"])
def test_methods_for_positions_refuse_the_edge_by_name(method):
    with pytest.raises(Exception, match=rf"integrator {method} .* sleigh_knife_edge\.force"):
        sleigh().simulation(integrator={"type": method})


LOOP = """
constraints:
- {{type: loop_closure, frame_a: coupler_link, point_a: [2.0, 0, 0], frame_b: rocker_link,
    point_b: [1.5, 0, 0], directions: xy}}
{edge}
"""
ON_A_CART = urdf(
    *(link("world"), link("along"), link("across"), link("cart", 4.0, (0.2, 0.1, 0.0))),
    *(rod("crank_link", 1.0, 1.0), rod("coupler_link", 2.0, 2.0), rod("rocker_link", 1.5, 1.5)),
    joint("x", "prismatic", "world", "along", (1, 0, 0)),
    joint("y", "prismatic", "along", "across", (0, 1, 0)),
    joint("turn", "revolute", "across", "cart"),
    joint("crank", "revolute", "cart", "crank_link"),
    joint("coupler", "revolute", "crank_link", "coupler_link", at=(1.0, 0.0, 0.0)),
    joint("rocker", "revolute", "cart", "rocker_link", at=(2.0, 0.0, 0.0)),
)


def cart(*edges):
    entries = "\n".join(
        f"- {{type: knife_edge, frame: {frame}, direction: [0, 1, 0]}}" for frame in edges
    )
    return scene_of(LOOP.format(edge=entries), ON_A_CART)


def open_cart(rng, scale):
    """A state of the cart whose loop is open by about `scale`, anywhere in the plane."""
    closed = assemble(
        cart().system(),
        State(0.0, np.array((0.0, 0.0, 0.0, 1.2, -1.0, 1.7)), np.zeros(6)),
    ).q
    moved = closed + np.concatenate((rng.uniform(-2.0, 2.0, 3), np.zeros(3)))
    return State(0.0, moved + scale * rng.normal(size=6), rng.normal(size=6))


@pytest.mark.parametrize("move", [project, assemble])
@pytest.mark.parametrize("edges", [("cart",), ("crank_link",), ("cart", "rocker_link")])
def test_an_edge_beside_a_loop_moves_nothing_that_the_loop_need_not_move(move, edges):
    """Positions are those without the edge; both velocities are the nearest ones."""
    rng, with_edge, without = np.random.default_rng(3), cart(*edges).system(), cart().system()
    for _ in range(5):
        x = open_cart(rng, 1e-3)
        found, other = move(with_edge, x), move(without, x)
        assert np.array_equal(found.q, other.q)
        J = with_edge.bilateral.jacobian(0.0, found.q)
        assert len(J) == 2 + len(edges) == len(without.rows) + len(edges)
        assert np.abs(J @ found.v).max() <= 1e-12
        M = with_edge.mass(found.q).dense.copy()
        nearest = x.v - np.linalg.solve(M, J.T) @ np.linalg.solve(
            J @ np.linalg.solve(M, J.T), J @ x.v
        )
        assert found.v == pytest.approx(nearest, abs=1e-9)


def test_a_projection_goes_no_farther_than_an_optimiser():
    """min |q - q0|_M on the loop alone, by a solver that knows nothing of the edge."""
    system, x = cart("cart").system(), open_cart(np.random.default_rng(5), 1e-2)
    M = system.mass(x.q).dense.copy()
    best = minimize(
        lambda q: 0.5 * (q - x.q) @ M @ (q - x.q),
        x.q,
        jac=lambda q: M @ (q - x.q),
        constraints={"type": "eq", "fun": lambda q: system.residual(0.0, q)},
        method="SLSQP",
        options={"ftol": 1e-16, "maxiter": 200},
    ).x
    assert assemble(system, x).q == pytest.approx(best, abs=1e-7)


def test_a_run_with_edge_and_loop_keeps_energy_and_rows():
    scene = cart("cart", "rocker_link")
    rng = np.random.default_rng(7)
    simulation = scene.simulation(integrator={"type": "dop853", "tolerance": 1e-11})
    x = simulation.start(open_cart(rng, 1e-3))
    states = list(simulation.run(x, 0.5))
    energy = [simulation.system.energy(x) for x in states]
    assert np.ptp(energy) <= 1e-8 * max(map(abs, energy))
    off = [violation(simulation.system, x) for x in states]
    assert max(each.position for each in off) <= 1e-12
    assert max(each.velocity for each in off) <= 1e-11


def edge_by_hand(scene, x):
    """J and drift of an edge across the y axis of the cart, from its three coordinates."""
    (_, _, turn), (vx, vy, w) = x.q[:3], x.v[:3]
    s, c = np.sin(turn), np.cos(turn)
    J = np.zeros(scene.robot.model.nv)
    J[:2] = -s, c
    return J, -w * (c * vx + s * vy)


@pytest.mark.parametrize("solver", ["kkt", "qp"])
def test_accelerations_are_those_of_equations_by_hand(solver):
    scene, rng = cart("cart"), np.random.default_rng(11)
    system = scene.system(solver={"type": solver})
    x = assemble(system, open_cart(rng, 1e-3))
    found = system.evaluate(x)
    model, data = scene.robot.model, pin.Data(scene.robot.model)
    M = pin.crba(model, data, x.q).copy()
    free = -pin.nonLinearEffects(model, data, x.q, x.v)
    J, drift = edge_by_hand(scene, x)
    at, h = system.constraints, 1e-6
    loops = [system.jacobian(0.0, x.q + s * h * x.v) @ x.v for s in (1, -1)]
    rows = np.vstack((system.jacobian(0.0, x.q), J))
    right = np.concatenate((-(loops[0] - loops[1]) / (2 * h), (-drift,)))
    m = len(rows)
    whole = np.block([[M, -rows.T], [rows, np.zeros((m, m))]])
    expected = np.linalg.solve(whole, np.concatenate((free, right)))
    assert len(at.rows) == 2
    assert found.a == pytest.approx(expected[: len(M)], abs=1e-7 * np.abs(expected).max())
    assert found.lam == pytest.approx(expected[len(M) :], abs=1e-7 * np.abs(expected).max())


def test_edges_beside_couplings_leave_the_reduced_tier():
    """A coupled joint steers the edge; the tier keeps both as rows, and the energy."""
    text = (
        "robot: {gravity: [0, 0, 0]}\ncouplings: {turn: {parent: x, factor: 0.5, offset: 0.1}}\n"
        f"constraints: [{EDGE}]\ndt: 0.01\n"
    )
    scene = scene_of(text, PLANAR)
    simulation = scene.simulation(integrator={"type": "dop853"})
    system = simulation.system
    first = simulation.start(State(0.0, np.zeros(3), np.array((1.0, 0.0, 0.5))))
    *_, x = simulation.run(first, 1.0)
    assert system.tier == "kkt"
    heading = 0.5 * x.q[0] + 0.1
    assert x.q[2] == pytest.approx(heading, abs=1e-12)
    assert x.v[1] * np.cos(heading) == pytest.approx(x.v[0] * np.sin(heading), abs=1e-12)
    # dy/dx = tan(heading) has an integral: y = -2 ln cos(x / 2 + 0.1) + constant
    y = first.q[1] - 2.0 * np.log(np.cos(heading) / np.cos(first.q[2]))
    assert x.q[1] == pytest.approx(y, abs=1e-9)


def test_redundant_edges_share_their_force():
    one, two = (
        sleigh(),
        scene_of(f"robot: {{gravity: [0, 0, 0]}}\nconstraints: [{EDGE}, {EDGE}]\n", PLANAR),
    )
    x = planar_start()
    alone, both = one.system().evaluate(x), two.system().evaluate(x)
    assert both.a == pytest.approx(alone.a, abs=1e-12)
    assert both.lam == pytest.approx(0.5 * np.repeat(alone.lam, 2), abs=1e-12)


def test_inverse_dynamics_counts_the_force_of_an_edge():
    """Efforts of two joints drive the cart; the edge and the loop return their multipliers."""
    scene, rng = cart("cart"), np.random.default_rng(2)
    torques = {"x": 3.0, "turn": -1.0, "crank": 2.0}
    forces = [
        {"type": "joint_torque", "joint": name, "torque": value} for name, value in torques.items()
    ]
    driven = scene_of(
        LOOP.format(edge="- {type: knife_edge, frame: cart, direction: [0, 1, 0]}")
        + f"forces: {forces}\n".replace("'", ""),
        ON_A_CART,
    )
    system = driven.system()
    x = assemble(system, open_cart(rng, 1e-3))
    now = system.evaluate(x)
    efforts = joint_efforts(scene.robot, tuple(torques))
    inverse = ClosedLoopInverseDynamics(scene.robot, scene.couplings, scene.constraints, efforts)
    found = inverse.solve(x, now.a)
    assert found.tau == pytest.approx(list(torques.values()), abs=1e-9)
    assert found.multipliers == pytest.approx(now.lam, abs=1e-9)
    slips = x._replace(v=x.v + np.array((0.0, 0.1, 0.0, 0.0, 0.0, 0.0)))
    again, _ = inverse.project_motion(slips, now.a)
    assert abs(edge_by_hand(scene, again)[0] @ again.v) <= 1e-12


@pytest.mark.parametrize("scene", [sleigh(), cart("cart", "rocker_link")], ids=["alone", "loop"])
@pytest.mark.parametrize("lacks", [None, 2])
def test_a_projected_measurement_keeps_the_edge_in_its_velocity_alone(scene, lacks):
    """All rates measured: the nearest ones; without that of the turn: the edge tells it."""
    system = scene.system()
    n, rng = system.nv, np.random.default_rng(4)
    x = State(0.0, rng.uniform(-0.5, 0.5, n), rng.normal(size=n))
    x = x if n == 3 else open_cart(rng, 1e-3)
    every, rates = np.ones(n, dtype=bool), np.ones(n, dtype=bool)
    if lacks is not None:
        rates[lacks] = False
    found = StateProjector(system).project(Measurement(x, every, rates)).x
    J = system.bilateral.jacobian(0.0, found.q)
    assert np.abs(J @ found.v).max() <= 1e-12
    if n == 3:
        assert np.array_equal(found.q, x.q)
    else:
        assert found.q == pytest.approx(assemble(cart().system(), x).q, abs=1e-9)
    if lacks is None:
        M = system.mass(x.q).dense.copy()
        share = np.linalg.solve(J @ np.linalg.solve(M, J.T), J @ x.v)
        assert found.v == pytest.approx(x.v - np.linalg.solve(M, J.T) @ share, abs=1e-9)


def test_direction_needs_a_length():
    with pytest.raises(SceneError, match="direction"):
        scene_of("constraints: [{type: knife_edge, frame: sleigh, direction: [0, 0, 0]}]", PLANAR)


def test_far_away_the_sleigh_goes_the_same_way():
    near, far = (sleigh().simulation(integrator={"type": "dop853"}) for _ in range(2))
    x, shift = planar_start(), np.array((1024.0, -4096.0, 0.0))
    *_, here = near.run(x, 1.0)
    *_, there = far.run(x._replace(q=x.q + shift), 1.0)
    assert there.q - shift == pytest.approx(here.q, abs=1e-11)
