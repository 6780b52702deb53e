"""The kinds of cases, one a reader of the package, and which readers they reach.

A reader is a suffix of the table of formats, an importer of models, a section of a task file, a
part that takes a file, or a word of a command that names a file: the package lists all of them.
"""

import argparse
import gzip
import json
import random
import typing
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType

from fuzz import arrays, bags, documents, scenes, seeds, tables, task_seeds, urdf
from fuzz.seeds import Seed
from fuzz.trial import Case
from fuzz.values import spoil_bytes

from mbd_ros.files.formats import BAGS, FOLDER, FORMATS, PICTURES
from mbd_ros.jobs.arguments import names_scenes
from mbd_ros.jobs.table import COMMANDS, command_module
from mbd_ros.methods.learned_model import LearnedFile
from mbd_ros.scene.models import model_entry
from mbd_ros.scene.schema.locate import path_word
from mbd_ros.scene.schema.registry import PARTS, resolve
from mbd_ros.scene.schema.sections import TASKS, keys

MILD = 0.45  # share of cases that only get numbers which are as good as others
SCENE = b'{"robot": {"urdf": "r.urdf"}}'
WRITTEN = frozenset(
    {"out", "output", "residuals", "innovations", "events", "page", "plot", "checkpoint"}
)
Spoil = Callable[[random.Random, bytes, bool], bytes]
SPOILS: Mapping[str, Spoil] = MappingProxyType(
    {
        ".yaml": documents.tree,
        **dict.fromkeys((".xml", ".osim", ".urdf"), documents.xml),
        ".npz": arrays.npz,
        ".parquet": arrays.parquet,
        ".onnx": arrays.learned,
        ".c3d": arrays.c3d,
        ".stl": arrays.stl,
    }
)


def mutated(rng: random.Random, seed: Seed) -> Case:
    """The case of a seed with a hostile file in it."""
    name, mild, files = rng.choice(seed.mutated), rng.random() < MILD, dict(seed.files)
    bag = name.partition("/")[0]
    if suffix_or_none(bag) in BAGS:
        own = {file: data for file, data in files.items() if file.partition("/")[0] == bag}
        files = {file: data for file, data in files.items() if file not in own}
        files |= bags.bag(rng, bag, own, mild)
    else:
        files[name] = _spoilt(rng, name, files[name], mild)
    return Case(seed.words, files, seed.out, seed.behind)


def _spoilt(rng: random.Random, name: str, data: bytes, mild: bool) -> bytes:
    if name.endswith(".gz"):
        inner = _spoilt(rng, name.removesuffix(".gz"), gzip.decompress(data), mild)
        packed = gzip.compress(inner, 1, mtime=0)
        return packed if mild or rng.random() < 0.6 else spoil_bytes(rng, packed)
    spoil = SPOILS.get("".join(Path(name).suffixes), tables.lines)
    if spoil is not tables.lines and not mild and rng.random() < 0.15:
        return spoil_bytes(rng, data)
    return spoil(rng, data, mild)


def suffix_or_none(name: str) -> str | None:
    """The suffix of a format; None for files of others."""
    if not Path(name).suffix:
        return FOLDER if name == "m" else None
    fitting = [suffix for suffix in FORMATS if suffix and name.endswith(suffix)]
    return max(fitting, key=len, default=None)


def scene_case(rng: random.Random) -> Case:
    """Random parts of the registry."""
    scene = scenes.mutated(rng)
    files = {
        "s.yaml": scene.text.encode("utf-8", "surrogatepass"),
        "r.urdf": scene.urdf.encode("utf-8", "surrogatepass"),
    }
    if rng.random() < 0.15:
        return Case(("check", "@s.yaml"), files)
    if rng.random() < 0.2:
        joints = tuple(f"j{i}" for i in range(1, 7))
        motion = {"m.csv": tables.table(rng, joints)}
        return Case(("inverse", "@s.yaml", "@m.csv", "-o", "@o.csv"), files | motion, "o.csv")
    words = ("simulate", "@s.yaml", "-t", "0.003", "-o", "@o.csv")
    if rng.random() < 0.2:
        words = (*words, "--integrator", rng.choice(tuple(scenes.PARTS["integrators"])))
    return Case(words, files, "o.csv")


def urdf_case(rng: random.Random) -> Case:
    """Random robots."""
    robot = urdf.mutated(rng)
    files = {"s.yaml": SCENE, "r.urdf": robot.text.encode("utf-8", "surrogatepass")}
    if rng.random() < 0.3:
        return Case(("check", "@s.yaml"), files)
    if rng.random() < 0.5:
        files["m.csv"] = tables.table(rng, robot.joints)
        return Case(("inverse", "@s.yaml", "@m.csv", "-o", "@o.csv"), files, "o.csv")
    return Case(("simulate", "@s.yaml", "-t", "0.002", "-o", "@o.csv"), files, "o.csv")


RANDOM = MappingProxyType({"scenes": scene_case, "urdf": urdf_case})  # not from seeds
OTHERS = MappingProxyType(
    {
        "learned": seeds.learned_seeds,
        "meshes": seeds.mesh_seeds,
        "particles": seeds.particle_seeds,
        "params-file": seeds.parameter_seeds,
    }
)
SUFFIXES = MappingProxyType(
    {suffix or "bag": suffix for suffix in FORMATS if suffix not in PICTURES}
)
KINDS = (*RANDOM, *SUFFIXES, *model_entry.FORMATS, *OTHERS, *task_seeds.SEEDS)


@cache
def seeds_of(kind: str) -> tuple[Seed, ...]:
    """The sound cases of a kind; none of those that are made at random."""
    if kind in SUFFIXES:
        return seeds.format_seeds(SUFFIXES[kind])
    if kind in model_entry.FORMATS:
        return seeds.importer_seeds(kind)
    makers = {**OTHERS, **task_seeds.SEEDS}
    return tuple(makers[kind]()) if kind in makers else ()


def case_of(name: str) -> Case:
    """The case of a seed such as scenes:1234."""
    kind, rng = name.partition(":")[0], random.Random(name)
    if kind in RANDOM:
        return RANDOM[kind](rng)
    return mutated(rng, rng.choice(seeds_of(kind)))


def readers() -> set[str]:
    """Everything that the package says it reads, beside scenes."""
    return {
        *(f"format {suffix}" for suffix in SUFFIXES.values()),
        *(f"model {form}" for form in model_entry.FORMATS),
        *(f"task {key}" for key in keys(TASKS)),
        *(f"part {kind}" for kind in _parts_with_files()),
        *(
            f"{command} {action.dest}"
            for command in COMMANDS
            for action in _files(command)
            if action.dest not in WRITTEN
        ),
    }


def _parts_with_files() -> Iterator[str]:
    for section, kinds in PARTS.items():
        for kind in kinds:
            part = resolve(section, kind, "")
            if LearnedFile in typing.get_type_hints(part.__init__).values():
                yield kind


def _parser(command: str) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(exit_on_error=False)
    command_module(command).add_arguments(parser)
    return parser


def _files(command: str) -> Iterator[argparse.Action]:
    """The words of a command that name files, but those of scenes."""
    for action in _parser(command)._actions:
        if action.type is path_word and not names_scenes(action):
            yield action


def read_by(seed: Seed) -> Iterator[str]:
    """The readers that get hostile files of a seed."""
    command, names = seed.words[0], {name.partition("/")[0] for name in seed.mutated}
    for name in names:
        if (suffix := suffix_or_none(name)) is not None:
            yield f"format {suffix}"
        if form := model_entry.format_of(Path(name)):
            yield f"model {form}"
        if name.endswith(".yaml"):
            yield from (f"task {key}" for key in json.loads(seed.files[name]))
    for name, text in seed.files.items():
        kinds = _parts_with_files() if name.endswith(".yaml") else ()
        yield from (f"part {kind}" for kind in kinds if kind.encode() in text)
    if command not in COMMANDS:
        return
    given = vars(_parser(command).parse_args(list(seed.words[1:])))
    for action in _files(command):
        values = given[action.dest]
        for value in values if isinstance(values, list) else [values]:
            if value is not None and str(value).removeprefix("@") in names:
                yield f"{command} {action.dest}"
