"""Return maps, their derivatives through events, periodic motions and branches of them.

The walkers are plain equations here, so that nothing of the package's mechanics has a part in it.
"""

import numpy as np
import pytest
from plain_walkers import rimless_wheel, simplest_walker

from mbd_ros.errors import FallError, SolveError
from mbd_ros.features.gait.continuation import DOUBLING, Continuation
from mbd_ros.features.gait.periodic import ReturnMap, multipliers, periodic_motion
from mbd_ros.methods.sensitivities.flow import Travel
from mbd_ros.methods.sensitivities.saltation import (
    derivative,
    guard_crossing,
    reset_along_guard,
    saltation,
    transition,
)

# Fixed points in 80-bit arithmetic, beyond the digits of Garcia et al. 1998: slope, theta,
# thetadot, phidot, period, multipliers.
GAITS = {
    "long": (
        *(0.009, 0.20031090054424708861, -0.19983247300495235399, -0.015822999948309382034),
        *(3.8824637528513741473, [-0.190099841066 + 0.557598776682j]),
    ),
    "short": (
        *(0.009, 0.19393736981018180588, -0.20386692744200692421, -0.015144260853191567481),
        *(3.0961058680781636907, [4.003864358929707, 0.45958958979767156]),
    ),
    "long, gentle": (
        *(0.004, 0.15338956487623631242, -0.15608014667568142654, -0.007287197449123496157),
        *(3.8526134617509812988, [0.22888996288846 + 0.59115519468348j]),
    ),
    "short, gentle": (
        *(0.004, 0.14877838696961964646, -0.15880667345760565205, -0.006978654498991893119),
        *(3.1165055983480139958, [3.2127693876334282, 0.5915522469844745]),
    ),
}


def section(walker, start):
    return walker.cycle(walker.state(start))[-1]


def gait(walker, start):
    at = section(walker, start)
    return periodic_motion(ReturnMap(walker, at, Travel()), at.end)


@pytest.mark.parametrize("name", GAITS)
def test_gaits_of_the_simplest_walker(name):
    slope, th, thd, phid, period, expected = GAITS[name]
    found = gait(simplest_walker(slope), [round(x, 3) for x in (th, 2.0 * th, thd, phid)])
    state = np.concatenate((found.state.q, found.state.v))
    assert state == pytest.approx([th, 2.0 * th, thd, phid], abs=1e-12)
    assert found.passage.period == pytest.approx(period, abs=1e-11)
    assert found.multipliers[: len(expected)] == pytest.approx(expected, abs=1e-9)
    assert np.abs(found.multipliers[2:]).max() == 0.0  # the reset forgets the swing leg
    assert found.is_stable == name.startswith("long")


def test_rimless_wheel_forgets_half_of_every_disturbance():
    found = gait(rimless_wheel(), [0.08 - np.pi / 8, 1.5])
    assert found.state.v[0] == pytest.approx(1.095462839647657, rel=1e-12)
    assert found.passage.period == pytest.approx(1.0345498114232794, rel=1e-12)
    assert found.multipliers[0] == pytest.approx(0.5, abs=1e-9)


@pytest.fixture(scope="module")
def two_steps():
    """Two steps of the simplest walker, off its gait, so that a heel strike is in between."""
    walker = simplest_walker(0.009, dt=0.05)  # whole steps differ by the error of their length
    at = section(walker, [0.201, 0.402, -0.2, -0.016])
    way = ReturnMap(walker, at, Travel(), cycles=2)
    return way, way.passage(at.end)


def test_derivative_of_a_return_map_against_differences_of_whole_steps(two_steps):
    way, passage = two_steps
    flow, h = way.flow, 2e-5

    def end(d):
        return flow.minus(way.passage(flow.plus(passage.begin, d)).back, passage.back)

    near, far = (np.array([end(s * d) - end(-s * d) for d in np.eye(4)]).T for s in (h, 2.0 * h))
    whole = (8.0 * near - far) / (12.0 * h)
    assert way.derivative(passage) == pytest.approx(whole, abs=1e-7)


def test_a_map_without_saltation_is_another_one(two_steps):
    """What the delay of an event does is forgotten: the derivative is off by more than it is."""
    way, passage = two_steps
    flow, (one, two) = way.flow, passage.segments
    jump = reset_along_guard(flow, one, guard_crossing(flow, one, one.end))
    plain = (
        transition(flow, two)
        @ derivative(flow, lambda y: flow.minus(flow.reset(one, y), one.after), one.end)
        @ transition(flow, one)
    )
    right = transition(flow, two) @ saltation(flow, one) @ transition(flow, one)
    differ = np.linalg.eigvals(plain) - np.linalg.eigvals(right)
    assert np.abs(differ).max() > 0.1
    assert np.abs(jump - saltation(flow, one)).max() > 0.1


def test_the_flow_of_time_is_carried_through_an_event():
    """S f- = f+: a later begin is a later end, whatever happens in between."""
    walker = simplest_walker(0.009, dt=0.05)  # whole steps differ by the error of their length
    at = section(walker, [0.2, 0.4, -0.2, -0.016])
    carried = saltation(walker, at) @ walker.rate(at.end)
    assert carried == pytest.approx(walker.rate(at.after), abs=1e-10)


def test_a_motion_that_grazes_its_guard_has_no_return_map():
    walker = rimless_wheel()
    at = section(walker, [0.08 - np.pi / 8, 1.5])
    still = at._replace(end=at.end._replace(v=np.array([0.0])))
    walker.guard = lambda y: y[1] ** 2
    with pytest.raises(SolveError, match="grazes strike"):
        saltation(walker, still)


def test_a_walker_that_falls_says_so():
    walker = simplest_walker(0.009)
    with pytest.raises(FallError, match="no strike"):
        walker.cycle(walker.state([0.2, 0.4, -0.1, 0.0]))


def test_a_nilpotent_part_adds_no_multipliers():
    map_ = np.array([[0.5, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1e-13, 0.0]])
    assert multipliers(np.triu(map_))[1:] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_period_doublings_of_the_simplest_walker():
    """The long gait doubles at 0.015088437941 rad, the doubled one at 0.0176694 rad.

    The first is stated by Garcia et al. 1998 as 0.015, the digits are of 80-bit arithmetic.
    """
    at = section(simplest_walker(0.009), [0.2, 0.4, -0.2, -0.0158])

    def family(slope):
        return ReturnMap(simplest_walker(slope), at, Travel())

    along = Continuation(family, 0.014, 0.018)
    first = periodic_motion(family(0.0145), at.end)
    branch = along.branch(first, 0.0145, 1)
    assert branch.ended == "end of the range"
    assert [mark.mark for mark in branch.bifurcations] == [DOUBLING]
    doubling = branch.bifurcations[0]
    assert doubling.parameter == pytest.approx(0.015088437941, abs=1e-8)
    assert doubling.motion.state.q[0] == pytest.approx(0.237165863592, abs=1e-8)
    assert doubling.motion.passage.period == pytest.approx(3.912409, abs=1e-6)
    doubled = along.follow_doubling(doubling, 1)
    assert doubled.cycles == 2
    assert [mark.mark for mark in doubled.bifurcations] == [DOUBLING]
    assert doubled.bifurcations[0].parameter == pytest.approx(0.0176694, abs=1e-7)
