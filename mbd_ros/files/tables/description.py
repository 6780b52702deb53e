"""Description of the columns of a result, as JSON text beside their numbers."""

import json
from collections.abc import Mapping
from typing import Any

from mbd_ros.errors import DataError
from mbd_ros.files.table import Column, Result

_VERSION = 1
_TEXTS = ("name", "unit", "frame")


def describe(result: Result, more: Mapping[str, Mapping[str, Any]] | None = None) -> str:
    """Names, units and frames of all columns, and the metadata.

    Args:
        more: Table -> column -> further keys that a format needs.
    """
    tables = {}
    for name, table in result.tables.items():
        further = (more or {}).get(name, {})
        tables[name] = [
            {key: getattr(column, key) for key in _TEXTS} | further.get(column.name, {})
            for column in table.columns
        ]
    whole = {"mbd_ros": _VERSION, "tables": tables, "metadata": result.metadata}
    return json.dumps(whole)


def described(text: str | bytes, where: str) -> tuple[dict[str, list[dict[str, Any]]], Any]:
    """Entries of the columns by table, and the metadata.

    Args:
        text: What `describe` gave.
        where: File, for the messages.

    Raises:
        DataError: It is something else.
    """
    try:
        description = json.loads(text)
        tables, metadata = description["tables"], description["metadata"]
        entries = [entry for columns in tables.values() for entry in columns]
        whole_texts = all(isinstance(entry[key], str) for entry in entries for key in _TEXTS)
        is_known = description["mbd_ros"] == _VERSION
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise DataError(f"{where}: its description of columns cannot be read ({error})") from error
    if not (is_known and whole_texts and isinstance(metadata, dict)):
        raise DataError(f"{where}: its description of columns is of another kind")
    return tables, metadata


def column_of(entry: Mapping[str, Any], values: Any) -> Column:
    """The column of an entry."""
    return Column(entry["name"], values, entry["unit"], entry["frame"])
