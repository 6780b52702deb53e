"""Tables as a notebook shows them: first and last rows and columns."""

import html

import numpy as np

from mbd_ros.files.table import Column, Result, Table

_SHOWN = 5  # columns, and rows, of each end
_TABLES = 4


def table_html(table: Table) -> str:
    """A table element; names are escaped, since they come from files of others."""
    columns = [table.columns[i] if i >= 0 else None for i in _ends(len(table.columns))]
    head = "".join(f"<th>{html.escape(c.label) if c else '…'}</th>" for c in columns)
    body = "".join(_row(columns, i) for i in _ends(table.rows))
    size = f"<caption>{table.rows} rows, {len(table)} columns</caption>"
    return f"<table>{size}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def result_html(result: Result) -> str:
    """A heading and a table element for each of the first tables."""
    shown = list(result.tables.items())[:_TABLES]
    return "".join(f"<h4>{html.escape(name)}</h4>{table_html(table)}" for name, table in shown)


def _row(columns: list[Column | None], row: int) -> str:
    cells = (_cell(c, row) if c is not None and row >= 0 else "…" for c in columns)
    return f"<tr>{''.join(f'<td>{cell}</td>' for cell in cells)}</tr>"


def _ends(count: int) -> list[int]:
    """Numbers of the first and last rows or columns; -1 stands for those between."""
    if count <= 2 * _SHOWN:
        return list(range(count))
    return [*range(_SHOWN), -1, *range(count - _SHOWN, count)]


def _cell(column: Column, row: int) -> str:
    value = column.values[row]
    return html.escape(f"{value:.6g}" if isinstance(value, np.floating) else str(value))
