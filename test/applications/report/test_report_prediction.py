"""Predictions in the report: errors against known costs, and costs that are wrong."""

from mbd_ros.applications.report.prediction import kind
from mbd_ros.applications.report.prediction.kind import PROBLEMS


def test_every_scheme_finds_the_least_cost_and_a_wrong_one_is_told():
    work = kind.items((), quick=True)
    assert {(i.spec["problem"], i.spec["scheme"]) for i in work} == {
        (name, scheme) for name in PROBLEMS for scheme in ("gauss", "radau", "hermite_simpson")
    }
    outcomes = [(item, kind.run(item.spec)) for item in work if "radau" in item.name]
    for _, outcome in outcomes:
        assert all(one["off"] < 1e-4 and one["replay"] < 1e-2 for one in outcome["runs"])
    section = kind.section(outcomes)
    assert not section.wrong
    assert len(section.tables[0].rows) == len(outcomes)
    assert set(section.figures) == {f"prediction_{name}" for name in PROBLEMS}

    item, outcome = outcomes[0]
    astray = {"runs": [outcome["runs"][0] | {"tolerance": 1e-7, "off": 1e-3}]}
    assert kind.section([(item, astray)]).wrong == ["cart_pole, radau: the cost is 1.0e-03 off"]


def test_scenes_of_a_user_have_no_known_costs():
    assert kind.items(["arm.yaml"], quick=False) == []
    assert "own problems" in kind.section([]).text[0]
