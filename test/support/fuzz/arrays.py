"""Files of arrays: .npz, .parquet, .onnx, .c3d and .stl, changed where their readers look."""

import io
import json
import random
import zipfile
from typing import Any

import numpy as np
from fuzz.documents import change_value, nested
from fuzz.values import NUMBERS, WORDS, near, spoil_bytes

from mbd_ros.methods.learned_model import ABOUT, SUM, ZEROS, signed

_KINDS = ("f2", ">f8", "f4", "i8", "u1", "?", "c16", "U3", "M8[s]", "m8[s]", "O", "f8,f8")
_HEADERS = (  # of an .npy
    "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 3), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (2.5,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': 3, }",
    "{'descr': '<V0', 'fortran_order': False, 'shape': (3,), }",
    "{'descr': '|O', 'fortran_order': False, 'shape': (3,), }",
    "{'descr': [('a', '<f8')], 'fortran_order': 0, 'shape': (3,), }",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (3,), 'more': 1}",
    "{'descr': '<f8', 'fortran_order': False, 'shape': (" + "(" * 5000,
    "{'descr': '<f8', ",
    "[]",
    "",
    "9" * 10_000,
    "{'descr': {}, 'fortran_order': True, 'shape': ()}",
)


def npz(rng: random.Random, data: bytes, mild: bool) -> bytes:
    """Other arrays; sums of the zip file are right."""
    with zipfile.ZipFile(io.BytesIO(data)) as packed:
        members = {name: packed.read(name) for name in packed.namelist()}
    name = rng.choice([name for name in members if not mild or "descr" not in name])
    array = np.load(io.BytesIO(members[name]), allow_pickle=False)
    draw = rng.random()
    if mild:
        members[name] = _npy(_near(rng, array))
    elif draw < 0.5:
        members[name] = _npy(_other(rng, array))
    elif draw < 0.7:
        text = rng.choice((*_HEADERS, repr({"descr": "<f8", "shape": array.shape})))
        head = text.encode().ljust(53) + b"\n"
        members[name] = (
            b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head + b"\x00" * 24
        )
    elif draw < 0.8:
        del members[name]
    elif draw < 0.9:
        members[rng.choice((*WORDS[:9], "a/b.npy", "../x.npy", *members))] = members[name]
    else:
        members[name] = spoil_bytes(rng, members[name])
    target = io.BytesIO()
    kind = rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))
    with zipfile.ZipFile(target, "w", kind) as packed:
        for key, content in members.items():
            packed.writestr(key.replace("\x00", "") or "x", content)
    return target.getvalue()


def _npy(array: Any) -> bytes:
    target = io.BytesIO()
    np.save(target, array, allow_pickle=True)  # that readers refuse
    return target.getvalue()


def _near(rng: random.Random, array: Any) -> Any:
    """The same shape and kind with one number changed a little, or the order of its axes."""
    if array.dtype.kind != "f" or not array.size:
        return array
    changed = np.array(array, order=rng.choice("FCC"))
    at = np.unravel_index(rng.randrange(array.size), array.shape)
    changed[at] = near(rng, float(changed[at]))
    return changed


def _other(rng: random.Random, array: Any) -> Any:
    if array.dtype.kind == "u" and array.ndim == 1:  # the description of a result
        return np.frombuffer(_json(rng, array.tobytes().decode()).encode(), np.uint8)
    if array.dtype.kind == "U" and array.ndim == 0:
        return np.array(_json(rng, str(array)))
    draw = rng.random()
    if draw < 0.35 and array.size and array.dtype.kind in "fi":
        changed = array.copy()
        values = (*NUMBERS, np.nan, np.inf, -np.inf)
        at = np.unravel_index(rng.randrange(array.size), array.shape)
        with np.errstate(all="ignore"):
            changed[at] = np.array(rng.choice(values), float).astype(array.dtype)
        return changed
    if draw < 0.6:
        try:
            return array.astype(rng.choice(_KINDS))
        except (ValueError, TypeError):
            return np.zeros(3)
    shaped = (array.T, array[None], array.ravel()[:0], array.ravel()[:1], np.float64(1.0))
    return rng.choice((*shaped, np.repeat(array[None], 3, axis=0), array.ravel()))


def _json(rng: random.Random, text: str) -> str:
    values = json.loads(text)
    change_value(rng, values, mild=False)
    return rng.choice((json.dumps(values),) * 8 + (nested(text), text[: len(text) // 2], "7"))


def parquet(rng: random.Random, data: bytes, mild: bool) -> bytes:
    """Other columns and metadata."""
    import pyarrow
    from pyarrow import parquet as files

    table = files.read_table(io.BytesIO(data))
    names = [name for name in table.column_names if not mild or name != "time"]
    i = table.column_names.index(rng.choice(names))
    column, draw = table.column(i), rng.random()
    if mild or draw < 0.25:
        values = column.to_numpy().copy()
        at = rng.randrange(len(values))
        values[at] = near(rng, float(values[at])) if mild else float(rng.choice((*NUMBERS, "nan")))
        table = table.set_column(i, table.field(i), pyarrow.array(values))
    elif draw < 0.6:
        count = len(column)
        others = (
            *(
                [None] * count,
                ["x"] * count,
                [[1.0, 2.0]] * count,
                [True] * count,
                [b"\xff"] * count,
            ),
            *([{"a": 1}] * count, [7] * count, [2**63 - 1] * count, [[]] * count),
        )
        table = table.set_column(i, table.column_names[i], pyarrow.array(rng.choice(others)))
    elif draw < 0.7:
        table = table.remove_column(i)
    elif draw < 0.8:
        new = rng.choice(("", "time", "a\x00b", "x" * 3000, table.column_names[0]))
        table = table.rename_columns(
            [new if k == i else n for k, n in enumerate(table.column_names)]
        )
    else:
        about = dict(table.schema.metadata or {b"x": b"{}"})
        key = rng.choice(list(about))
        about[key] = rng.choice(
            (
                b"",
                b"\xff",
                b"{",
                b"[" * 100_000,
                b"7",
                b'{"tables": 1}',
                _described(rng, about[key]),
            )
        )
        table = table.replace_schema_metadata(about)
    target = io.BytesIO()
    files.write_table(table, target)
    return target.getvalue()


def _described(rng: random.Random, about: bytes) -> bytes:
    try:
        return _json(rng, about.decode()).encode("utf-8", "surrogatepass")
    except ValueError:
        return b"{}"


def learned(rng: random.Random, data: bytes, mild: bool) -> bytes:
    """Another network or other metadata; its sum is right."""
    import onnx

    model = onnx.load_model_from_string(data)
    about = {entry.key: entry for entry in model.metadata_props}
    graph, draw = model.graph, rng.random()
    if mild:
        constant = rng.choice([one for one in graph.initializer if one.raw_data])
        values = np.frombuffer(constant.raw_data).copy()
        if len(values):
            values[rng.randrange(len(values))] *= rng.uniform(0.99, 1.01)
            constant.raw_data = values.tobytes()
    elif draw < 0.4:
        about[ABOUT].value = _json(rng, about[ABOUT].value)
    elif draw < 0.6:
        constant = rng.choice(graph.initializer)
        rng.choice((_poison, _reshape, _elsewhere))(rng, constant)
    elif draw < 0.75:
        node = rng.choice(graph.node)
        key = rng.choice(("op_type", "domain", "name"))
        setattr(node, key, rng.choice(("Custom", "ai.onnx.ml", "Gemm", "Loop", "../x", "Tanh")))
    elif draw < 0.85:
        side = rng.choice((*graph.input, *graph.output))
        side.type.tensor_type.elem_type = rng.choice((1, 7, 8, 11, 99))
    else:
        part = rng.choice((graph.node, graph.initializer, graph.input, graph.output))
        del part[rng.randrange(len(part))]
    about[SUM].value = ZEROS
    content = model.SerializeToString()
    try:
        content = signed(content)
    except ValueError:
        return content
    return content


def _poison(rng: random.Random, constant: Any) -> None:
    values = np.frombuffer(constant.raw_data, np.uint8).copy()
    pairs = values[: len(values) // 8 * 8].view(np.float64)
    if len(pairs):
        pairs[rng.randrange(len(pairs))] = rng.choice((np.nan, np.inf, 1e300))
    constant.raw_data = values.tobytes()


def _reshape(rng: random.Random, constant: Any) -> None:
    del constant.dims[:]
    constant.dims.extend(rng.choice(((2**40,), (0,), (-1, 3), (1, 1, 1, 1), (2**31, 2**31), ())))


def _elsewhere(rng: random.Random, constant: Any) -> None:
    """Data in another file."""
    constant.ClearField("raw_data")
    constant.data_location = 1
    for key, value in (
        ("location", rng.choice(("/etc/passwd", "../r.urdf", "s.yaml"))),
        ("offset", "0"),
    ):
        entry = constant.external_data.add()
        entry.key, entry.value = key, value


_BLOCK = 512  # bytes of a .c3d


def c3d(rng: random.Random, data: bytes, mild: bool) -> bytes:
    """Other numbers in header, parameters and frames."""
    changed = bytearray(data)
    begin = (int.from_bytes(data[16:18], "little") - 1) * _BLOCK
    for _ in range(1 if mild else rng.choice((1, 1, 2, 4))):
        draw = rng.random()
        if mild or draw < 0.3:
            at = begin + 4 * rng.randrange((len(data) - begin) // 4)
            value = np.frombuffer(data[at : at + 4], "<f4")[0] * (
                rng.uniform(0.999, 1.001) if mild else 1.0
            )
            poisoned = rng.choice((np.nan, np.inf, 1e38, -1.0, 0.0))
            changed[at : at + 4] = np.float32(value if mild else poisoned).tobytes()
        elif draw < 0.65:
            at = 2 * rng.randrange(12)
            changed[at : at + 2] = rng.choice((0, 1, 2, 255, 32767, 65535)).to_bytes(2, "little")
        else:
            at = rng.randrange(_BLOCK, begin)
            changed[at] = rng.choice((0, 1, 255, 128, changed[at] ^ 1))
    return bytes(changed)


def stl(rng: random.Random, data: bytes, mild: bool) -> bytes:
    """Other corners, or another number of facets."""
    changed = bytearray(data)
    if not mild and rng.random() < 0.3:
        changed[80:84] = rng.choice((0, 1, 11, 13, 2**31, 2**32 - 1)).to_bytes(4, "little")
        return bytes(changed)
    facet, k = rng.randrange((len(data) - 84) // 50), rng.randrange(9)
    if mild:
        changed[84 + 50 * facet + 4 * (k % 3)] = rng.randrange(256)  # of the normal
        return bytes(changed)
    at = 84 + 50 * facet + 12 + 4 * k
    value = rng.choice((np.nan, np.inf, 1e38, 0.0, 1e-38, 0.3))
    changed[at : at + 4] = np.float32(value).tobytes()
    return bytes(changed)
