"""JSON and protobuf messages to columns: message by message, since neither has a fixed layout."""

import json
from collections.abc import Callable
from typing import Any

import numpy as np

from demoplan.logs.columns import Columns, Field, MissingFieldError, Resolved, Wanted, parse_path, resolve
from demoplan.logs.definitions import Node, Number, Record, Repeated, Text
from demoplan.logs.layouts import EACH, Interner, Path
from demoplan.logs.messages import Block

_NANOSECONDS_PER_SECOND = 1_000_000_000
_DEEPEST = 64


class _AbsentError(Exception):
    """A message does not have a value where one is wanted."""


class ObjectDecoder:
    """Decodes blocks of messages that parse to nested dicts and lists."""

    def __init__(
        self,
        parse: Callable[[memoryview], Any],
        node: Record | None,
        wanted: Wanted,
        interner: Interner,
    ) -> None:
        """Find the wanted fields in the type, or later in the first message if no type is declared.

        Raises:
            MissingFieldError: If the type does not have a required one.
        """
        self._parse = parse
        self._wanted = wanted
        self._interner = interner
        self._resolved: Resolved | None = None if node is None else resolve(node, wanted)
        self._list: Path = () if wanted.list_path is None else parse_path(wanted.list_path)

    def decode(self, block: Block) -> Columns:
        """Rows of a block."""
        message: list[int] = []
        values: dict[str, list[Any]] = {}
        problems: dict[str, int] = {}
        for row in range(len(block.starts)):
            try:
                value = self._parse(block.payload(row))
                found = self._rows(value)
            except _AbsentError as error:
                problems[str(error)] = problems.get(str(error), 0) + 1
                continue
            except (ValueError, RecursionError) as error:
                problem = f"it is not what its encoding says: {str(error)[:120]}"
                problems[problem] = problems.get(problem, 0) + 1
                continue
            for element in found:
                message.append(row)
                for key, item in element.items():
                    values.setdefault(key, []).append(item)
        columns = Columns(np.array(message, np.int64), refused=[(n, why) for why, n in problems.items()])
        for item in self._wanted.fields:
            if item.key not in values:
                continue
            if item.form == "numbers":
                columns.numbers[item.key] = np.array(values[item.key], np.float64)
            elif item.form == "stamp":
                columns.stamps[item.key] = np.array(values[item.key], np.int64)
            else:
                codes = [self._interner.code(text) for text in values[item.key]]
                columns.texts[item.key] = np.array(codes, np.int32)
        return columns

    def _rows(self, value: Any) -> list[dict[str, Any]]:
        if self._resolved is None:
            # A list that is empty tells nothing about its elements: wait for a message that has some.
            if self._list and not _at(value, self._list, ()):
                return []
            self._resolved = resolve(infer(value), self._wanted)
        elements = [value] if self._wanted.list_path is None else _at(value, self._list, ())
        if not isinstance(elements, list):
            raise _AbsentError(f"field {self._wanted.list_path!r} is no list")
        return [self._row(value, element) for element in elements]

    def _row(self, value: Any, element: Any) -> dict[str, Any]:
        assert self._resolved is not None
        row: dict[str, Any] = {}
        for item in self._wanted.fields:
            paths = self._resolved.components.get(item.key)
            if paths is None:
                continue
            parts = []
            for path in paths:
                inner = path[path.index(EACH) + 1 :] if EACH in path else path
                parts.append(_at(element if EACH in path else value, inner, None))
            row[item.key] = _value(item, parts)
        return row


def _value(item: Field, parts: list[Any]) -> Any:
    """A field's value from its components."""
    if item.form == "text":
        return "" if parts[0] is None else str(parts[0])
    if item.form == "stamp":
        if any(isinstance(part, bool) or not isinstance(part, int) for part in parts):
            return 0
        return min(max(parts[0] * _NANOSECONDS_PER_SECOND + parts[1], -(2**63)), 2**63 - 1)
    if any(not isinstance(part, int | float) for part in parts):
        if item.is_required:
            raise _AbsentError(f"it has no {item.paths[0]!r}")
        return [float("nan")] * len(parts)
    return parts


def _at(value: Any, path: Path, default: Any) -> Any:
    for step in path:
        if isinstance(step, int):
            if not isinstance(value, list) or step >= len(value):
                return default
            value = value[step]
        elif isinstance(value, dict):
            value = value.get(str(step), default)
        else:
            return default
    return value


def infer(value: Any, depth: int = 0) -> Record:
    """The type that a parsed message seems to have.

    Raises:
        MissingFieldError: If it is no record, or nested without end.
    """
    if not isinstance(value, dict):
        raise MissingFieldError("its messages are no records (JSON objects)")
    return Record("", tuple((str(name), _inferred(child, depth + 1)) for name, child in value.items()))


def _inferred(value: Any, depth: int) -> Node:
    if depth > _DEEPEST:
        raise MissingFieldError(f"its messages are nested more than {_DEEPEST} deep")
    if isinstance(value, dict):
        return Record("", tuple((str(name), _inferred(child, depth + 1)) for name, child in value.items()))
    if isinstance(value, list):
        return Repeated(_inferred(value[0], depth + 1) if value else Number("f8"))
    return Number("f8") if isinstance(value, int | float) else Text()


def parse_json(payload: memoryview) -> Any:
    """A JSON message."""
    return json.loads(bytes(payload))
