"""Protobuf messages, from the descriptors that an MCAP file carries; nothing generated, nothing imported.

Source: https://protobuf.dev/programming-guides/encoding/ and google/protobuf/descriptor.proto.
"""

import struct
from collections.abc import Callable, Iterator
from typing import Any

from demoplan.logs.definitions import Node, Number, Record, Repeated, Text, UnknownTypeError

_VARINT, _I64, _LEN, _I32 = 0, 1, 2, 5
_DOUBLE, _FLOAT, _INT64, _UINT64, _INT32, _FIXED64, _FIXED32, _BOOL, _STRING = range(1, 10)
_GROUP, _MESSAGE, _BYTES, _UINT32, _ENUM, _SFIXED32, _SFIXED64, _SINT32, _SINT64 = range(10, 19)
_REPEATED = 3
_DEEPEST = 64

_FIXED = {
    _DOUBLE: struct.Struct("<d"),
    _FLOAT: struct.Struct("<f"),
    _FIXED64: struct.Struct("<Q"),
    _FIXED32: struct.Struct("<I"),
    _SFIXED64: struct.Struct("<q"),
    _SFIXED32: struct.Struct("<i"),
}

Fields = dict[int, tuple[str, int, bool, str]]
"""Number → name, type, whether it repeats, type name."""


def _varint(data: memoryview, pos: int) -> tuple[int, int]:
    value, shift = 0, 0
    while True:
        if pos >= len(data) or shift > 63:
            raise ValueError("a number does not end")
        byte = data[pos]
        pos += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & (2**64 - 1), pos
        shift += 7


def _wire(data: memoryview) -> Iterator[tuple[int, int, Any]]:
    """(field number, wire type, value) of a message."""
    pos = 0
    while pos < len(data):
        tag, pos = _varint(data, pos)
        kind = tag & 7
        if kind == _VARINT:
            value, pos = _varint(data, pos)
            yield tag >> 3, kind, value
            continue
        if kind == _LEN:
            size, pos = _varint(data, pos)
        elif kind in (_I64, _I32):
            size = 8 if kind == _I64 else 4
        else:
            raise ValueError(f"wire type {kind} is not used any more")
        if pos + size > len(data):
            raise ValueError("a field ends outside its message")
        yield tag >> 3, kind, data[pos : pos + size]
        pos += size


def _types(schema: bytes) -> dict[str, Fields]:
    """Fields of every message type in a ``FileDescriptorSet``."""
    types: dict[str, Fields] = {}
    for number, _, file in _wire(memoryview(schema)):
        if number != 1:
            continue
        parts = list(_wire(file))
        package = next((bytes(value).decode() for n, _, value in parts if n == 2), "")
        for n, _, value in parts:
            if n == 4:
                _collect(value, f".{package}" if package else "", types, 0)
    return types


def _collect(data: memoryview, scope: str, types: dict[str, Fields], depth: int) -> None:
    if depth > _DEEPEST:
        raise ValueError("types are nested without end")
    parts = list(_wire(data))
    name = scope + "." + next(bytes(value).decode() for n, _, value in parts if n == 1)
    fields: Fields = {}
    for n, _, value in parts:
        if n == 2:
            about: dict[int, Any] = {
                key: bytes(item).decode() if isinstance(item, memoryview) else item
                for key, _, item in _wire(value)
                if key in (1, 3, 4, 5, 6)
            }
            fields[about[3]] = (about[1], about[5], about.get(4) == _REPEATED, about.get(6, ""))
        elif n == 3:
            _collect(value, name, types, depth + 1)
    types[name] = fields


def parser_of(name: str, schema: bytes) -> tuple[Record, Callable[[memoryview], Any]]:
    """The tree of fields of a type, and a function that parses its messages to nested dicts.

    Scalars that a message leaves out have their default, as proto3 says; records left out are absent.

    Raises:
        UnknownTypeError: If the schema does not parse, or does not hold the type.
    """
    try:
        types = _types(schema)
    except (ValueError, KeyError, StopIteration, struct.error) as error:
        raise UnknownTypeError(f"the log's descriptors of {name} do not parse: {error}") from None
    root = "." + name.lstrip(".")
    if root not in types:
        raise UnknownTypeError(
            f"the log's descriptors do not hold {name}; they hold: {', '.join(sorted(types))}"
        )

    def node_of(kind: str, seen: tuple[str, ...]) -> Record:
        fields: list[tuple[str, Node]] = []
        for field_name, field_type, is_repeated, inner in types.get(kind, {}).values():
            child: Node = Number("f8")
            if field_type == _MESSAGE:
                # A type may hold itself: go round once, nobody maps deeper.
                child = node_of(inner, (*seen, inner)) if inner not in seen else Record(inner, ())
            elif field_type in (_STRING, _BYTES):
                child = Text()
            fields.append((field_name, Repeated(child) if is_repeated else child))
        return Record(kind, tuple(fields))

    def parse(payload: memoryview) -> dict[str, Any]:
        return _message(payload, root, types, 0)

    return node_of(root, (root,)), parse


def _message(data: memoryview, kind: str, types: dict[str, Fields], depth: int) -> dict[str, Any]:
    if depth > _DEEPEST:
        raise ValueError("messages are nested without end")
    fields = types.get(kind, {})
    result: dict[str, Any] = {}
    for name, field_type, is_repeated, _ in fields.values():
        if is_repeated:
            result[name] = []
        elif field_type != _MESSAGE:
            result[name] = "" if field_type in (_STRING, _BYTES) else 0
    for number, wire_type, value in _wire(data):
        if number not in fields:
            continue
        name, field_type, is_repeated, inner = fields[number]
        if field_type == _MESSAGE:
            items: list[Any] = [_message(value, inner, types, depth + 1)]
        elif field_type == _STRING:
            items = [bytes(value).decode(errors="replace")]
        elif field_type == _BYTES:
            items = [bytes(value)]
        elif field_type in _FIXED:
            items = [found[0] for found in _FIXED[field_type].iter_unpack(value)]
        elif wire_type == _LEN:
            items, pos = [], 0
            while pos < len(value):
                item, pos = _varint(value, pos)
                items.append(_signed(item, field_type))
        else:
            items = [_signed(value, field_type)]
        if is_repeated:
            result[name] += items
        elif items:
            result[name] = items[-1]
    return result


def _signed(value: int, field_type: int) -> int:
    if field_type in (_SINT32, _SINT64):
        return (value >> 1) ^ -(value & 1)
    if field_type in (_INT32, _INT64, _ENUM) and value >= 2**63:
        return value - 2**64
    return value
