"""Message definitions to trees of fields: from the log, from ``.msg`` files, or the standard ones."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.base import TypesysError

from demoplan.logs.messages import Channel


@dataclass(frozen=True)
class Number:
    """A number of fixed size; ``code`` is numpy's, without byte order: ``f8``, ``i4``, ``u1``."""

    code: str

    @property
    def size(self) -> int:
        """Bytes."""
        return int(self.code[1:])


@dataclass(frozen=True)
class Text:
    """A string; ``is_wide`` for the rare 16-bit kind."""

    is_wide: bool = False


@dataclass(frozen=True)
class Repeated:
    """Several of one kind; ``count`` is null where each message says how many."""

    element: "Node"
    count: int | None = None


@dataclass(frozen=True, eq=False)
class Record:
    """A message type: its fields in order."""

    name: str
    fields: tuple[tuple[str, "Node"], ...]

    @cached_property
    def by_name(self) -> "dict[str, Node]":
        """Fields by their name."""
        return dict(self.fields)


Node: TypeAlias = Number | Text | Repeated | Record

_NUMBERS = {
    "bool": "u1",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "int64": "i8",
    "uint64": "u8",
    "float32": "f4",
    "float64": "f8",
}
_MOST_DEFINITION_BYTES = 2**20
_DEEPEST = 64


class UnknownTypeError(Exception):
    """A message type has no definition that can be used."""


@dataclass(frozen=True)
class Definitions:
    """Where definitions come from that a log does not carry: own folders first, then the standard types."""

    folders: tuple[Path, ...] = ()
    _own: dict[str, Any] = field(default_factory=dict, compare=False)

    def node(self, channel: Channel) -> Record:
        """The tree of fields of a ROS channel's type.

        Raises:
            UnknownTypeError: If no definition is found, or it does not parse.
        """
        name = normal_name(channel.message_type)
        is_ros1 = channel.encoding == "ros1"
        types = {**self._own_types(), **_parsed(channel.schema_encoding, channel.schema, name)}
        return _record(name, types, _standard(is_ros1), is_ros1, 0)

    def _own_types(self) -> dict[str, Any]:
        if not self._own:
            for folder in self.folders:
                for path in sorted(folder.rglob("*.msg")):
                    self._own.update(_from_file(path))
        return self._own


def normal_name(name: str) -> str:
    """``package/msg/Name`` for ``package/Name`` too.

    >>> normal_name("tf2_msgs/TFMessage")
    'tf2_msgs/msg/TFMessage'
    """
    parts = name.replace("::", "/").split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else "/".join(parts)


def _from_file(path: Path) -> dict[str, Any]:
    """Types of one ``package/msg/Name.msg`` (or ``package/Name.msg``)."""
    package = path.parent.parent.name if path.parent.name == "msg" else path.parent.name
    if path.stat().st_size > _MOST_DEFINITION_BYTES:
        raise UnknownTypeError(f"definition {path.name} is larger than {_MOST_DEFINITION_BYTES} bytes")
    try:
        return dict(get_types_from_msg(path.read_text(errors="replace"), f"{package}/msg/{path.stem}"))
    except TypesysError as error:
        raise UnknownTypeError(f"definition {path.name} does not parse: {_first_line(error)}") from None


@lru_cache(maxsize=256)
def _parsed(encoding: str, schema: bytes, name: str) -> dict[str, Any]:
    """Types that a log's own definition declares; none if it carries none."""
    if not schema.strip() and encoding not in ("ros2msg", "ros1msg"):
        return {}
    if not schema.strip() and name.split("/", maxsplit=1)[0] not in ("std_msgs", "std_srvs"):
        # An empty text is a definition only of types without fields; recorders also write it for 'not found'.
        return {}
    if len(schema) > _MOST_DEFINITION_BYTES:
        raise UnknownTypeError(
            f"the log's definition of {name} is larger than {_MOST_DEFINITION_BYTES} bytes"
        )
    text = schema.decode(errors="replace")
    try:
        if encoding == "ros2idl" or re.match(r"=+\s*\nIDL: ", text):
            return dict(get_types_from_idl(text))
        return dict(get_types_from_msg(text, name))
    except (TypesysError, RecursionError) as error:
        raise UnknownTypeError(
            f"the log's definition of {name} does not parse: {_first_line(error)}"
        ) from None


def _first_line(error: BaseException) -> str:
    return str(error).split("\n")[0][:200]


@lru_cache(maxsize=2)
def _standard(is_ros1: bool) -> dict[str, Any]:
    """Definitions of the standard types."""
    return dict(get_typestore(Stores.ROS1_NOETIC if is_ros1 else Stores.LATEST).fielddefs)


def _record(name: str, types: dict[str, Any], standard: dict[str, Any], is_ros1: bool, depth: int) -> Record:
    if depth > _DEEPEST:
        raise UnknownTypeError(f"type {name} is nested more than {_DEEPEST} deep")
    found = types.get(name) or standard.get(name)
    if found is None:
        raise UnknownTypeError(
            f"type {name} has no definition in the log, in the mapping's 'definitions' folders or among the "
            "standard types; add its .msg file to a folder that the mapping lists under 'definitions'"
        )

    def node(description: Any) -> Node:
        kind, detail = description
        if kind == Nodetype.BASE:
            base = detail[0]
            if base in ("string", "wstring"):
                return Text(is_wide=base == "wstring")
            if base not in _NUMBERS:
                raise UnknownTypeError(f"type {name} has a field of kind {base}, which is not supported")
            return Number(_NUMBERS[base])
        if kind == Nodetype.NAME:
            return _record(detail, types, standard, is_ros1, depth + 1)
        element, count = detail
        return Repeated(node(element), count if kind == Nodetype.ARRAY else None)

    fields = tuple((field_name, node(description)) for field_name, description in found[1])
    if not fields and not is_ros1:
        # ROS 2 gives a type without fields one byte, since IDL knows no empty structures.
        fields = (("structure_needs_at_least_one_member", Number("u1")),)
    return Record(name, fields)


def leaf_paths(node: Node, prefix: str = "", most: int = 60) -> Iterator[str]:
    """Field paths below a node, for messages that say what is available."""
    if isinstance(node, Record):
        for name, child in node.fields:
            yield from leaf_paths(child, f"{prefix}.{name}" if prefix else name, most)
    elif isinstance(node, Repeated) and isinstance(node.element, Record):
        yield from leaf_paths(node.element, f"{prefix}[]", most)
    else:
        yield prefix + ("[]" if isinstance(node, Repeated) else "")
