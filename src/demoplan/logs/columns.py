"""What is wanted of a message, and the columns that come of it, whatever the encoding."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from demoplan.logs.definitions import Node, Number, Record, Repeated, Text, leaf_paths
from demoplan.logs.layouts import EACH, Path, Step
from demoplan.logs.messages import Block, Times

Form: TypeAlias = Literal["numbers", "text", "stamp"]

XYZ = ("x", "y", "z")
XYZW = ("x", "y", "z", "w")
_SECONDS = ("sec", "secs", "seconds")
_NANOSECONDS = ("nanosec", "nsec", "nsecs", "nanos")


@dataclass(frozen=True)
class Field:
    """One wanted field.

    ``paths`` are alternatives: the first that the type has is taken. Only a required field must exist.
    ``labels`` are the sub-fields of a vector (or its first elements, if it is an array); none for a scalar.
    """

    key: str
    paths: tuple[str, ...]
    form: Form
    labels: tuple[str, ...] = ()
    is_element: bool = False
    is_required: bool = True


@dataclass(frozen=True)
class Wanted:
    """Everything wanted of one type: fields of the message, and of each element of at most one list."""

    fields: tuple[Field, ...]
    list_path: str | None = None


@dataclass(frozen=True)
class Resolved:
    """Where the fields of ``Wanted`` are in one type: per key, the paths of its components."""

    components: dict[str, tuple[Path, ...]]

    @property
    def paths(self) -> list[Path]:
        """Every path, once."""
        return list(dict.fromkeys(path for paths in self.components.values() for path in paths))


@dataclass(eq=False)
class Columns:
    """Rows that came of a block: one per message, or per element of the list that was wanted."""

    message: Times
    """Which message of the block each row comes from ``(m,)``, ascending."""
    numbers: dict[str, NDArray[np.float64]] = field(default_factory=dict)
    """``(m, components)``; missing keys are fields that the type does not have."""
    texts: dict[str, NDArray[np.int32]] = field(default_factory=dict)
    """Codes of an ``Interner`` ``(m,)``."""
    stamps: dict[str, Times] = field(default_factory=dict)
    """Nanoseconds ``(m,)``."""
    refused: list[tuple[int, str]] = field(default_factory=list)
    """(number of messages, why they did not decode)."""


class Decoder(Protocol):
    """Blocks of one channel to columns."""

    def decode(self, block: Block) -> Columns:
        """Rows of a block."""


class MissingFieldError(Exception):
    """A type does not have a field that is wanted, or has it in a form that cannot be used."""


def parse_path(text: str) -> Path:
    """Steps of a field path.

    >>> parse_path("poses[2].position")
    ('poses', 2, 'position')

    Raises:
        MissingFieldError: If the text is not a path.
    """
    steps: list[Step] = []
    if re.fullmatch(r"[A-Za-z_]\w*(\[\d+\])*(\.[A-Za-z_]\w*(\[\d+\])*)*", text) is None:
        raise MissingFieldError(f"{text!r} is not a field path; write one like pose.position or axes[0]")
    for name, index in re.findall(r"([A-Za-z_]\w*)|\[(\d+)\]", text):
        steps.append(name or int(index))
    return tuple(steps)


def resolve(node: Node, wanted: Wanted) -> Resolved:
    """Where the wanted fields are in a type.

    Raises:
        MissingFieldError: If a required field, or the list, is not there; the message says what is.
    """
    root: Node = node
    prefix: Path = ()
    element: Node | None = None
    if wanted.list_path is not None:
        found = _at(node, parse_path(wanted.list_path))
        if not isinstance(found, Repeated) or not isinstance(found.element, Record):
            problem = "is no list of records" if found is not None else "does not exist"
            raise MissingFieldError(f"field {wanted.list_path!r} {problem}; {_available(node)}")
        element, prefix = found.element, (*parse_path(wanted.list_path), EACH)
    components: dict[str, tuple[Path, ...]] = {}
    for item in wanted.fields:
        base, start = (element, prefix) if item.is_element and element is not None else (root, ())
        problems = []
        for text in item.paths:
            path = parse_path(text)
            target = _at(base, path)
            parts = None if target is None else _parts(target, item)
            if parts is not None:
                components[item.key] = tuple((*start, *path, *part) for part in parts)
                break
            problems.append("does not exist" if target is None else f"is not {_described(item)}")
        else:
            if item.is_required:
                listed = " or ".join(repr(text) for text in item.paths)
                raise MissingFieldError(f"field {listed} {problems[0]}; {_available(base)}")
    return Resolved(components)


def _at(node: Node | None, path: Path) -> Node | None:
    for step in path:
        if isinstance(step, int):
            node = (
                node.element
                if isinstance(node, Repeated) and (node.count is None or step < node.count)
                else None
            )
        else:
            node = node.by_name.get(step) if isinstance(node, Record) else None
        if node is None:
            return None
    return node


def _parts(node: Node, item: Field) -> list[Path] | None:
    """Paths of a field's components below it; null if it has another form."""
    if item.form == "text":
        return [()] if isinstance(node, Text | Number) else None
    if item.form == "stamp":
        if not isinstance(node, Record):
            return None
        seconds = next((name for name in _SECONDS if name in node.by_name), None)
        nanoseconds = next((name for name in _NANOSECONDS if name in node.by_name), None)
        return None if seconds is None or nanoseconds is None else [(seconds,), (nanoseconds,)]
    if not item.labels:
        return [()] if isinstance(node, Number) else None
    if isinstance(node, Repeated) and isinstance(node.element, Number):
        n_labels = len(item.labels)
        return [(i,) for i in range(n_labels)] if node.count is None or node.count >= n_labels else None
    if isinstance(node, Record):
        children = [node.by_name.get(label) for label in item.labels]
        return [(label,) for label in item.labels] if all(isinstance(c, Number) for c in children) else None
    return None


def _described(item: Field) -> str:
    if item.form == "text":
        return "a text"
    if item.form == "stamp":
        return "a time stamp"
    if not item.labels:
        return "a number"
    return f"a record of {', '.join(item.labels)} or an array of {len(item.labels)} numbers"


def _available(node: Node, most: int = 40) -> str:
    paths = list(leaf_paths(node))
    shown = ", ".join(paths[:most]) or "none"
    return f"available: {shown}" + (f" … ({len(paths)} in all)" if len(paths) > most else "")


def joined(parts: Sequence[Columns]) -> Columns:
    """Several columns as one, rows sorted by message, elements of one message in order."""
    if len(parts) == 1:
        return parts[0]
    refused = [problem for part in parts for problem in part.refused]
    filled = [part for part in parts if len(part.message)]
    if not filled:
        return Columns(np.empty(0, np.int64), refused=refused)
    message = np.concatenate([part.message for part in filled])
    order = np.argsort(message, kind="stable") if (np.diff(message) < 0).any() else slice(None)

    def of(columns: Iterable[NDArray[np.generic]]) -> NDArray[np.generic]:
        return np.concatenate(list(columns))[order]

    return Columns(
        message[order],
        {key: of(part.numbers[key] for part in filled) for key in filled[0].numbers},  # type: ignore[misc]
        {key: of(part.texts[key] for part in filled) for key in filled[0].texts},  # type: ignore[misc]
        {key: of(part.stamps[key] for part in filled) for key in filled[0].stamps},  # type: ignore[misc]
        refused,
    )
