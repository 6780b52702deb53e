"""Generate the reference of sections and parts from signatures, examples and docstrings."""

import dataclasses
import inspect
import math
import re
import typing
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

import yaml
from docstrings import body, summary
from tables import code, table

from mbd_ros.core.ranges import ANY_NUMBER, LARGEST, SMALLEST, Within, described
from mbd_ros.scene.schema.registry import PARTS, types_of
from mbd_ros.scene.schema.schema import entries
from mbd_ros.scene.schema.sections import SECTIONS, TASKS, Form, Section

TASK_KEYS = {  # the function or class whose keyword arguments are the keys of a section
    "simulate": "mbd_ros.features.simulation.task:task_of_keys",
    "kinematics": "mbd_ros.features.markers.kinematics_task:task_of_keys",
    "scale": "mbd_ros.features.markers.scale.task:task_of_keys",
    "muscles": "mbd_ros.features.muscles.task:task_of_keys",
    "estimate": "mbd_ros.features.estimation.task:EstimateTask",
    "gait": "mbd_ros.features.gait.task:_task",
    "predict": "mbd_ros.features.prediction.task:_task",
    "sample": "mbd_ros.features.sampling.task:SampleTask",
}
_COLUMNS = ("key", "takes", "unit", "default", "accepted", "means")
_HEAD = """\
# Sections and parts

With this page you can look up every section of a scene file, every part with its keys, units,
defaults and accepted values, and the keys of [task files](#task-files). `make docs` generates it
from the code; [scene.md](scene.md) explains sections in context. All parts also take the key
`name`.
"""


def page() -> str:
    """Return the page as Markdown."""
    pieces = [_HEAD, _overview()]
    for section in SECTIONS:
        if types_of(section):
            pieces.append(f"## {section.key}\n\n{_form(section)}")
            pieces += [_part(section, name, where) for name, where in types_of(section).items()]
    for kind in PARTS.keys() - {section.parts for section in SECTIONS} - {"controllers"}:
        pieces += [f"## {kind}\n\nParts of task files.", parts_of(kind)]
    pieces.append("## Task files\n\nA task file has a section for each job that reads it.")
    pieces += [_task(section.key) for section in TASKS]
    return "\n\n".join(pieces) + "\n"


def parts_of(kind: str) -> str:
    """Return the parts of a kind that no section of a scene contains, as Markdown."""
    return "\n\n".join(_describe(name, _import(at), {}) for name, at in PARTS[kind].items())


def _task(key: str) -> str:
    """Return the keys of a section of a task file, as Markdown."""
    builder = _import(TASK_KEYS[key])
    return f"### Task {key}\n\n{table(_COLUMNS, _keys(builder))}"


def _overview() -> str:
    rows = [
        (code(s.key), s.form.value, ", ".join(map(code, types_of(s))), "scene") for s in SECTIONS
    ]
    rows += [(code(s.key), s.form.value, "", "task file") for s in TASKS]
    return table(("section", "contains", "types", "file"), rows)


def _form(section: Section) -> str:
    earlier = [code(key) for key in section.after]
    after = f", built after {', '.join(earlier)}" if earlier else ""
    return f"Contains {section.form.value}{after}."


def _part(section: Section, name: str, where: str) -> str:
    part = _import(where)
    example = {"type": name, **getattr(part, "example", {})}
    entry: Any = example
    if section.form is Form.LIST:
        entry = [example]
    elif section.form is Form.NAMED:
        entry = {"my_name": example}
    return _describe(name, part, {section.key: entry})


def _describe(name: str, part: Any, example: Mapping[str, Any]) -> str:
    pieces = [f"### {name}", summary(part)]
    if example:
        text = yaml.safe_dump(example, sort_keys=False, default_flow_style=None, width=96)
        pieces.append(f"```yaml\n{text}```")
    rows = list(_keys(part))
    if rows:
        pieces.append(table(_COLUMNS, rows))
    pieces += [body(part), f"Code: `{part.__module__}`"]
    return "\n\n".join(piece for piece in pieces if piece)


def _keys(part: Any) -> Iterator[tuple[str, ...]]:
    """Yield a row for each keyword argument of a function or class, which a file may contain."""
    made_by = part.__init__ if inspect.isclass(part) else part
    hints = typing.get_type_hints(made_by, include_extras=True)
    texts = entries(part.__doc__) or entries(made_by.__doc__)
    texts = texts or entries(hints.get("return").__doc__, "Attributes")
    fields = (
        {f.name: f for f in dataclasses.fields(part)} if dataclasses.is_dataclass(part) else {}
    )
    for parameter in inspect.signature(part).parameters.values():
        if parameter.kind is not parameter.KEYWORD_ONLY and parameter.name not in fields:
            continue
        name, default = parameter.name, parameter.default
        if name in fields and fields[name].default_factory is not dataclasses.MISSING:
            default = fields[name].default_factory()
        annotation = described(hints.get(name, Any))
        accepted = (
            f"{annotation.length} numbers" if annotation.length else _range(annotation.within)
        )
        yield (
            code(name.rstrip("_")),
            _kind(annotation.kind),
            annotation.unit,
            _default(default),
            accepted,
            texts.get(name, ""),
        )


def _range(within: Within | None) -> str:
    """Describe a range; ends that only keep products finite are omitted."""
    if within is None or within == ANY_NUMBER or math.isinf(within.low):
        return ""
    if within.high == LARGEST and not within.of_size:
        return {0.0: ">= 0", SMALLEST: "> 0"}.get(within.low, f">= {within.low:g}")
    return str(within)


def _kind(hint: Any) -> str:
    """Describe a type as it appears in a file."""
    origin, inner = typing.get_origin(hint), typing.get_args(hint)
    scalars = {float: "number", int: "integer", str: "text", bool: "true or false"}
    if origin is typing.Literal:
        return " or ".join(map(code, inner))
    if hint in scalars:
        return scalars[hint]
    if origin is typing.Annotated:
        return _kind(inner[0])
    if inner and origin is not None and inspect.isclass(origin) and issubclass(origin, Mapping):
        return "mapping" if inner[1] is Any else f"mapping to {_kind(inner[1])}"
    if inner and inspect.isclass(origin) and origin.__name__ in ("Sequence", "list", "tuple"):
        plural = {
            "number": "numbers",
            "text": "texts",
            "mapping": "mappings",
            "see below": "values",
        }
        member = _kind(inner[0])
        return f"list of {plural.get(member, member)}"
    if inner:
        return " or ".join(_kind(member) for member in inner if member is not type(None))
    return getattr(hint, "__name__", str(hint)) if hint is not Any else "see below"


def _default(value: Any) -> str:
    if value is inspect.Parameter.empty:
        return "required"
    if value is None:
        return "none"
    plain = list(value) if isinstance(value, tuple) else value
    return code(re.sub(r"\n(\.\.\.)?", "", yaml.safe_dump(plain, default_flow_style=True)))


def _import(where: str) -> Any:
    module, _, name = where.partition(":")
    return getattr(import_module(module), name)
