"""Options of a command, made from the signature and the docstring of its job.

A command names its job as `module:function` or `module:Class`. Kind, choices, default and text of
an option then stand in one place. The job is parsed, not imported: so help and shell completion
stay quick, and need neither Pinocchio nor ROS.
"""

import argparse
import ast
import re
from collections.abc import Callable, Collection, Iterator, Mapping
from functools import cache
from importlib.util import find_spec
from typing import Any, NamedTuple

from mbd_ros.scene.schema.locate import path_word
from mbd_ros.scene.schema.schema import entries

_KINDS: Mapping[str, Callable[[str], Any]] = {
    "float": float,
    "int": int,
    "str": str,
    "bool": bool,
    "Path": path_word,
}
_CODE = re.compile(r"`([^`]*)`")
_LISTS = ("Sequence", "tuple", "list")


class Parameter(NamedTuple):
    """A parameter of a job.

    Attributes:
        kind: Function that makes a value of a text; None where no text can be one.
        is_list: Whether it takes several values.
        choices: The accepted values; empty accepts any.
        default: Default of the signature; None where there is none.
        text: Its description in the docstring, in one line.
    """

    kind: Callable[[str], Any] | None = None
    is_list: bool = False
    choices: tuple[Any, ...] = ()
    default: Any = None
    text: str = ""


def add_options(parser: argparse.ArgumentParser, job: str, *names: str) -> None:
    """Declare options that are parameters of a job and are spelled like them.

    Args:
        job: The job as `module:name`.
        *names: Names of the parameters; `emg_use` becomes `--emg-use`.
    """
    for name in names:
        add_option(parser, job, name)


def add_option(
    parser: argparse.ArgumentParser,
    job: str,
    name: str,
    *flags: str,
    only_given: bool = False,
    **changes: Any,
) -> None:
    """Declare one option, or one argument without a dash, that is a parameter of a job.

    Args:
        job: The job as `module:name`.
        name: Name of the parameter, which is also the name of the attribute with its value.
        *flags: Spellings on the command line, by default `--` and the name.
        only_given: Whether the attribute is None unless the option is given; the job, or a task
            file, then knows the default that the help shows.
        **changes: Keyword arguments of `add_argument` that differ from those of the signature.
    """
    names = parameters_of(job)
    parameter = names[name]
    if "default" in changes:
        parameter = parameter._replace(default=changes["default"])
    settings: dict[str, Any] = {"default": None if only_given else parameter.default}
    settings["help"] = help_text(parameter, names)
    flags = flags or (f"--{name.replace('_', '-')}",)
    if flags[0].startswith("-"):
        settings["dest"] = name
    if parameter.kind is bool:
        settings["action"] = "store_true"
    else:
        settings["type"] = parameter.kind
        settings["choices"] = parameter.choices or None
        settings["nargs"] = "+" if parameter.is_list else None
    parser.add_argument(*flags, **settings | changes)


def help_text(parameter: Parameter, names: Collection[str] = ()) -> str:
    """Return the help of an option: its description, then its default if it has one.

    Args:
        names: Names that the description writes in backticks and the help as options.
    """
    text = _CODE.sub(lambda match: _written(match[1], names), parameter.text).replace("%", "%%")
    default = parameter.default
    if default is None or default is False or default == ():
        return text
    shown = " ".join(map(str, default)) if isinstance(default, tuple) else str(default)
    end = "." if text.endswith(".") else ""
    return f"{text.removesuffix('.')} (default: {shown}){end}"


def _written(code: str, names: Collection[str]) -> str:
    return f"--{code.replace('_', '-')}" if code in names else code


def given_options(arguments: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Return the options that are not None, by name."""
    values = {name: getattr(arguments, name) for name in names}
    return {name: value for name, value in values.items() if value is not None}


@cache
def parameters_of(job: str) -> Mapping[str, Parameter]:
    """Return the parameters of a function, or the fields of a NamedTuple or dataclass, by name.

    Args:
        job: The function or class as `module:name`.
    """
    module, _, name = job.partition(":")
    (definition,) = (node for node in _tree(module).body if getattr(node, "name", "") == name)
    docstring = ast.get_docstring(definition)  # type: ignore[arg-type]
    texts = entries(docstring) or entries(docstring, "Attributes")
    return {
        key: _kind(annotation, module)._replace(
            default=_literal(default, module), text=texts.get(key, "")
        )
        for key, annotation, default in _declared(definition)
    }


@cache
def _tree(module: str) -> ast.Module:
    """Return the parsed source of a module, which is not imported."""
    spec = find_spec(module)
    return ast.parse(spec.loader.get_source(module))  # type: ignore[union-attr]


@cache
def _named(name: str, module: str) -> tuple[ast.expr, str] | None:
    """Return the expression that a name stands for, and its module; None where there is none."""
    for node in _tree(module).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == name:
            return node.value, module
        if isinstance(node, ast.ImportFrom) and any(alias.name == name for alias in node.names):
            is_own = str(node.module).startswith("mbd_ros.")
            return _named(name, str(node.module)) if is_own else None
    return None


def _declared(definition: Any) -> Iterator[tuple[str, ast.expr | None, ast.expr | None]]:
    """Yield name, annotation and default of the parameters of a function or fields of a class."""
    if isinstance(definition, ast.ClassDef):
        for node in definition.body:
            if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
                yield node.target.id, node.annotation, node.value
        return
    arguments = definition.args
    positional = [*arguments.posonlyargs, *arguments.args]
    defaults = [None] * (len(positional) - len(arguments.defaults)) + arguments.defaults
    for argument, default in zip(positional, defaults, strict=True):
        yield argument.arg, argument.annotation, default
    for argument, default in zip(arguments.kwonlyargs, arguments.kw_defaults, strict=True):
        yield argument.arg, argument.annotation, default


def _literal(default: ast.expr | None, module: str) -> Any:
    """Return the value of a literal, or of a name that stands for one; None for anything else."""
    if isinstance(default, ast.Name):
        named = _named(default.id, module)
        return None if named is None else _literal(*named)
    try:
        return None if default is None else ast.literal_eval(default)
    except ValueError:
        return None


def _kind(annotation: ast.expr | None, module: str) -> Parameter:
    """Return the kind that an annotation states; of a union the kind that a text can be."""
    if isinstance(annotation, ast.BinOp):
        members = [_kind(each, module) for each in (annotation.left, annotation.right)]
        preferred = [m for m in members if m.is_list or m.kind is path_word]
        usable = preferred + [m for m in members if m.kind is not None]
        return usable[0] if usable else Parameter()
    if isinstance(annotation, ast.Name):
        if annotation.id in _KINDS:
            return Parameter(_KINDS[annotation.id])
        named = _named(annotation.id, module)
        return Parameter() if named is None else _kind(*named)
    if isinstance(annotation, ast.Subscript) and isinstance(annotation.value, ast.Name):
        inner = annotation.slice
        first = inner.elts[0] if isinstance(inner, ast.Tuple) else inner
        if annotation.value.id == "Literal":
            choices = ast.literal_eval(inner)
            choices = choices if isinstance(choices, tuple) else (choices,)
            return Parameter(type(choices[0]), choices=choices)
        if annotation.value.id == "Annotated":
            return _kind(first, module)
        if annotation.value.id in _LISTS:
            return _kind(first, module)._replace(is_list=True)
    return Parameter()
