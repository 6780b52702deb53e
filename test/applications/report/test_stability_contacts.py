"""Rows of the map with contacts: known motion, and laws that every state is asked for."""

import numpy as np
import pytest

from mbd_ros.applications.report.contact.ours import scene_of
from mbd_ros.applications.report.stability import contact as verdicts
from mbd_ros.applications.report.stability import kind
from mbd_ros.applications.report.stability.contact import contact_rows
from mbd_ros.applications.report.stability.verdicts import BOUNDED, CONVERGED, STOPPED, WRONG
from mbd_ros.errors import SolveError

ROWS = {row.label: row for row in contact_rows(quick=False)}
DROP = ROWS["ball from 100 m, e = 0.5"].problem


def test_rows_are_of_every_kind_that_is_asked_and_have_names_of_their_own():
    families = " ".join(row.family for row in ROWS.values())
    for word in ("mass ratio", "friction", "redundant", "edge on edge", "drop", "steps of 0.1"):
        assert word in families
    assert {"mu = 0", "mu = 1.5 sticks", "steep cone, mu = 100"} <= set(ROWS)
    assert len({row.name for row in ROWS.values()}) == len(ROWS)
    assert len(contact_rows(quick=True)) == 6


def test_friction_tips_no_plate_that_should_slide_flat():
    """The pressure that balances friction at the lower side stands under the plate."""
    for row in ROWS.values():
        for plate in (solid for solid in row.problem.solids if solid.name == "plate"):
            assert row.problem.mu * plate.at[2] < 0.5 * plate.size[0] or not plate.v[0]


@pytest.mark.parametrize("label", ["mu = 1.5 sticks", "falls 5 cm"])
def test_a_row_has_a_clean_cell_for_every_method(label):
    row = kind.contact_row(ROWS[label])
    methods = [cell["method"] for cell in row["cells"]]
    smooth = ["rk4", "dop853"] if ROWS[label].problem.is_smooth else []
    assert methods == [*smooth, "moreau_jean"]
    assert [cell["kind"] for cell in row["cells"]] == [CONVERGED] * len(methods)


def test_events_find_the_stop_under_the_steepest_cone():
    row = ROWS["steep cone, mu = 100"]
    assert verdicts.judge_contact(row.problem, "dop853", row.dt).kind == CONVERGED


def falling(heights, speeds):
    """States of the ball at heights of its middle."""
    scene = scene_of(DROP)
    states = []
    for i, (z, v) in enumerate(zip(heights, speeds, strict=True)):
        x = scene.initial
        q, speed = x.q.copy(), np.zeros(6)
        q[2], speed[2] = z, v
        states.append(x._replace(t=0.1 * i, q=q, v=speed))
    return scene, states


@pytest.mark.parametrize(
    ("heights", "speeds", "said"),
    [
        ([2.0, 1.0], [0.0, -1.0], ""),
        ([2.0, 1.0], [0.0, -((2.0 * 9.81 * 1.001) ** 0.5)], "gains"),
        ([2.0, 0.1 - 1e-6], [0.0, -1.0], "ground"),
        ([2.0, 1.0], [0.0, np.nan], "finite"),
    ],
)
def test_laws_see_a_gain_of_energy_a_depth_and_what_is_no_number(heights, speeds, said):
    found = verdicts.faults(DROP, *falling(heights, speeds))
    assert said in found if said else not found


def test_a_motion_that_no_shorter_step_mends_is_wrong():
    """The same with another restitution than that of the closed form."""
    verdict = verdicts.judge_contact(DROP._replace(restitution=0.4), "rk4", 0.6)
    assert verdict.kind == WRONG and "shorter" in verdict.text


def test_a_coarse_step_that_shorter_ones_mend_is_bounded():
    row = ROWS["bounces of e = 0.8"]
    assert verdicts.judge_contact(row.problem, "moreau_jean", row.dt).kind in (BOUNDED, CONVERGED)


def test_a_stop_is_named_or_wrong(monkeypatch):
    def stopping(text):
        def attempt(*_):
            raise SolveError(text)

        return attempt

    for text, judged in (("at t = 1 s", STOPPED), ("singular", WRONG)):
        monkeypatch.setattr(verdicts, "_attempt", stopping(text))
        assert verdicts.judge_contact(DROP, "rk4", 0.01).kind == judged


def test_the_page_has_rows_with_contacts():
    row = kind.contact_row(ROWS["falls 5 cm"])
    item = kind.Item("stability", "one", {"contact": "one"}, 1.0)
    section = kind.section([(item, row)])
    table = next(table for table in section.tables if table.title == "Verdicts by method")
    counts = {cells[0]: cells[1] for cells in table.rows}
    assert counts["moreau_jean"] == "1" and counts["adams"] == "0"
    assert "stability_map" in section.figures and not section.wrong
