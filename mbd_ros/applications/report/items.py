"""Parts of a report: independent pieces of work, and sections made of their results."""

import importlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol

Spec = Mapping[str, Any]  # whatever JSON holds
Outcome = dict[str, Any]  # whatever JSON holds

PARTS: Mapping[str, str] = {  # kind of item -> module; their order is that of the sections
    "precision": "mbd_ros.applications.report.precision.kind",
    "peers": "mbd_ros.applications.report.peers.kind",
    "contact": "mbd_ros.applications.report.contact.kind",
    "prediction": "mbd_ros.applications.report.prediction.kind",
    "stability": "mbd_ros.applications.report.stability.kind",
    "long_runs": "mbd_ros.applications.report.stability.long_runs",
    "left_out": "mbd_ros.applications.report.left_out.kind",
}


class Item(NamedTuple):
    """One piece of work: independent of all others, and the same wherever it runs.

    Attributes:
        kind: A key of `PARTS`.
        name: Unique within its kind; letters, digits, `_`, `-`, `.`.
        spec: Argument of `run` of its module; with `name` the identity of the result. A scene
            that it measures is its entry `scene`.
        seconds: About how long it takes.
        alone: It times something: no other item runs beside it, and its result is for one kind
            of processor only.
    """

    kind: str
    name: str
    spec: Spec
    seconds: float
    alone: bool = False


class Table(NamedTuple):
    """A table of a section: texts, ready to be shown.

    Below the last table whose title begins with `subject: ` stand the figures whose names end
    with that subject, and the snippets whose titles begin with it.
    """

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]


class Section(NamedTuple):
    """A part of the page.

    Attributes:
        text: Paragraphs, plain text.
        tables: Shown after the text.
        figures: File name without ending -> matplotlib Figure; the rest is shown after the
            tables.
        wrong: Why the report fails; empty where everything is right.
        snippets: Title -> lines that a user can paste into a scene.
        headline: Titles of the tables, and names of the figures, that docs/report.md shows, too.
    """

    title: str
    text: Sequence[str]
    tables: Sequence[Table] = ()
    figures: Mapping[str, Any] = {}
    wrong: Sequence[str] = ()
    snippets: Mapping[str, str] = {}
    headline: Sequence[str] = ()


class Part(Protocol):
    """Contract of a module of `PARTS`."""

    def items(self, scenes: Sequence[str], quick: bool) -> list[Item]:
        """The work: for the scenes that a user names, or where there are none for all of ours.

        Items that need an optional package are left out where it is not installed.
        """
        ...

    def run(self, spec: Spec) -> Outcome:
        """Do one item; errors of the package are an outcome, not an exception."""
        ...

    def section(self, outcomes: Sequence[tuple[Item, Outcome]]) -> Section:
        """The section of the items that did not fail; without any, why there are none."""
        ...


def part(kind: str) -> Part:
    """The module of a kind."""
    module: Any = importlib.import_module(PARTS[kind])
    return module  # type: ignore[no-any-return]
