"""How commands speak: results on stdout, messages and progress on stderr, and exit codes."""

import json
import math
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from enum import IntEnum
from typing import Any, NoReturn

import polars as pl
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

NS_COLUMNS = ("_ns",)
"""Columns with such an ending leave as text in JSON: 64-bit integers do not survive every reader."""


class Exit(IntEnum):
    """How a command ends."""

    FINE = 0
    FAILED = 1
    WRONG_ARGUMENTS = 2
    DATA_LOSS = 3


WIDTH_OF_FILES = 180
"""Width of tables where stdout is not a terminal."""

stdout = Console(highlight=False, width=None if sys.stdout.isatty() else WIDTH_OF_FILES)
stderr = Console(stderr=True, highlight=False)


def say(message: str) -> None:
    """A message for the person; never part of the result."""
    stderr.print(message, markup=False)


def warn(message: str) -> None:
    """A message that something is not as it should be."""
    stderr.print(f"[yellow]warning:[/] {escape(message)}")


def fail(message: str, code: Exit = Exit.FAILED) -> NoReturn:
    """Say what is wrong, and end."""
    stderr.print(f"[red]error:[/] {escape(message)}", soft_wrap=True)
    raise SystemExit(int(code))


def print_json(value: Any) -> None:
    """A result as JSON: sorted keys, nanoseconds as text, NaN as null."""
    sys.stdout.write(json.dumps(_jsonable(value), sort_keys=True, indent=1, allow_nan=False) + "\n")


def _jsonable(value: Any, key: str = "") -> Any:
    if isinstance(value, pl.DataFrame):
        return [_jsonable(row) for row in value.iter_rows(named=True)]
    if isinstance(value, dict):
        return {str(name): _jsonable(item, str(name)) for name, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset | pl.Series):
        items = sorted(value) if isinstance(value, set | frozenset) else value
        return [_jsonable(item, key) for item in items]
    if isinstance(value, bool) or value is None:
        return value
    if isinstance(value, int):
        return str(value) if key.endswith(NS_COLUMNS) else int(value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return str(value)


def print_table(title: str, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """A small table for the person who reads the terminal."""
    table = Table(title=title, title_justify="left", header_style="bold", pad_edge=False, box=SIMPLE_HEAD)
    for index, column in enumerate(columns):
        table.add_column(column, overflow="fold", no_wrap=index == 0)
    for row in rows:
        table.add_row(*(escape("" if cell is None else str(cell)) for cell in row))
    stdout.print(table)


def print_frame(title: str, table: pl.DataFrame, *, limit: int) -> None:
    """The head of a table."""
    shown = table.head(limit)
    print_table(title, shown.columns, (tuple(_short(cell) for cell in row) for row in shown.iter_rows()))
    if table.height > limit:
        say(f"{limit} of {table.height} rows; --limit N shows more, --json all that are asked for")


def _short(cell: object) -> str:
    if isinstance(cell, float):
        return f"{cell:.4g}"
    if isinstance(cell, list | pl.Series):
        return ", ".join(_short(item) for item in cell)
    return "" if cell is None else str(cell)


@contextmanager
def progress(description: str, total: int, *, is_quiet: bool = False) -> Iterator[Callable[[str], None]]:
    """A bar on stderr; call what it gives with the name of each thing that is done."""
    bar = Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeElapsedColumn(),
        TextColumn("{task.fields[last]}"),
        console=stderr,
        transient=False,
        disable=is_quiet or not stderr.is_terminal,
    )
    with bar:
        task = bar.add_task(description, total=total, last="")

        def done(name: str) -> None:
            bar.update(task, advance=1, last=escape(name))

        yield done
