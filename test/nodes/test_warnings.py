"""What a node says of messages that it drops: each reason at once, no flood."""

import pytest

from mbd_ros.nodes.shell import diagnostics
from mbd_ros.nodes.shell.diagnostics import QUIET, VARIETY, Drops


@pytest.fixture
def clock(monkeypatch):
    """The time that `Drops` sees; `clock[0]` sets it."""
    now = [0.0]
    monkeypatch.setattr(diagnostics, "monotonic", lambda: now[0])
    return now


def test_a_second_refusal_shows_its_own_reason_at_once(clock):
    said = []
    drops = Drops(said.append)
    drops.add("reference", "joint1 at 3.5 at t = 1.25 s")
    drops.add("reference", "joint2 at 3.5 at t = 1.25 s")
    drops.add("reference", "joint1 at -4e-3 at t = 2.5 s")  # the same, but for numbers
    assert said == [
        "joint1 at 3.5 at t = 1.25 s (dropped for 'reference': 1)",
        "joint2 at 3.5 at t = 1.25 s (dropped for 'reference': 2)",
    ]
    clock[0] = QUIET
    drops.add("reference", "joint1 at 5 at t = 9 s")
    assert said[2:] == ["joint1 at 5 at t = 9 s (dropped for 'reference': 4)"]


def test_a_flood_of_different_reasons_is_cut_off_and_not_kept(clock):
    said = []
    drops = Drops(said.append)
    for k in range(5000):
        clock[0] = 0.001 * k
        drops.add("malformed", f"name{k} is strange")
    assert len(said) == VARIETY
    assert drops.counts == {"malformed": 5000}
    assert len(drops._quiet_until["malformed"]) == VARIETY
    drops.add("jump", "joint1 jumped")
    assert len(said) == VARIETY + 1
