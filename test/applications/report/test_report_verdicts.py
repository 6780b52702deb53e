"""What fails a report: runs that stop on scenes of this package, and references nobody checked."""

import json

import pytest

from mbd_ros.applications.report.items import Item
from mbd_ros.applications.report.left_out import kind as left_out
from mbd_ros.applications.report.peers import kind as peers
from mbd_ros.applications.report.peers.kind import compose
from mbd_ros.applications.report.precision import kind as precision
from mbd_ros.applications.report.precision.converged import known
from mbd_ros.applications.report.precision.reference_problems import SCENES

PENDULUM = f"{SCENES}/a01_pendulum_maximal.yaml"


def precision_item(family):
    (found,) = [i for i in precision.items([PENDULUM], True) if i.name.endswith(f".{family}")]
    return found


@pytest.fixture(scope="module")
def rk4():
    work = precision_item("rk4")
    return work, json.loads(json.dumps(precision.run(work.spec)))


def test_a_motion_that_no_second_method_computed_is_no_reference(rk4, monkeypatch):
    """With every second method gone the same item is wrong, and nothing is offered."""
    monkeypatch.setattr("mbd_ros.applications.report.precision.converged._SECOND", ())
    monkeypatch.setattr("mbd_ros.applications.report.precision.kind.known", known.__wrapped__)
    reference = precision_item("reference")
    outcome = json.loads(json.dumps(precision.run(reference.spec)))
    assert outcome["agreement"] is None and outcome["published"] < 1e-12
    section = precision.section([(reference, outcome), rk4])
    assert section.wrong == ["a01_pendulum_maximal: unchecked reference"]
    assert section.snippets == {}
    (headline,) = [table for table in section.tables if table.title in section.headline]
    assert headline.rows[0][2] == "unchecked reference, see References"
    users = [(i._replace(spec={**i.spec, "scene": "/mine.yaml"}), o) for i, o in (rk4,)]
    unsure = precision.section(users)
    assert unsure.wrong == [] and unsure.snippets == {}


def test_what_stops_is_wrong_on_a_scene_of_this_package(rk4):
    failed = {"failed": "SolveError: no step"}
    assert "a01_pendulum_maximal.rk4: SolveError: no step" in (
        precision.section([(rk4[0], failed)]).wrong
    )
    users = rk4[0]._replace(spec={**rk4[0].spec, "scene": "/mine.yaml"})
    assert precision.section([(users, failed)]).wrong == []
    (work,) = left_out.items([PENDULUM], True)
    assert left_out.section([(work, failed)]).wrong == [
        "a01_pendulum_maximal: SolveError: no step"
    ]


def test_a_motion_without_a_second_method_is_no_reference():
    facts = {"span": 1.0, "setups": [], "left": [], "refused": [], "quick": True}
    outcome = {"runs": [], "agreement": None, "check": "", **facts}
    section = compose([("arm7_swing", outcome)], [])
    assert section.wrong == ["arm7_swing: unchecked reference"] and section.tables == ()


def test_peers_that_stop_are_wrong_on_a_scene_of_this_package():
    own, user = (
        Item("peers", name, {"scene": scene}, 1.0)
        for name, scene in (("arm", f"{SCENES}/arm7_swing.yaml"), ("mine", "/mine.yaml"))
    )
    section = peers.section([(own, {"failed": "SolveError: no"}), (user, {"failed": "x"})])
    assert section.wrong == ["arm: SolveError: no"]
