"""CDR and ROS 1 messages to columns, through layouts."""

import numpy as np
from numpy.typing import NDArray

from demoplan.logs.columns import Columns, Field, Wanted, joined, resolve
from demoplan.logs.definitions import Record
from demoplan.logs.layouts import (
    EACH,
    Format,
    Group,
    Interner,
    Layout,
    LayoutFinder,
    Place,
    integers,
    numbers,
    seconds_and_nanoseconds,
)
from demoplan.logs.messages import Block, Bytes

_MOST_CODES = 1024
"""Codes of layouts that are kept at a time."""


class SerialisedDecoder:
    """Decodes blocks of one type; remembers the layouts that it met."""

    def __init__(self, node: Record, form: Format, wanted: Wanted, interner: Interner) -> None:
        """Find the wanted fields in the type.

        Raises:
            MissingFieldError: If the type does not have a required one.
        """
        self._wanted = wanted
        self._interner = interner
        self._resolved = resolve(node, wanted)
        paths = self._resolved.paths
        self._each_path = next((path for path in paths if EACH in path), None)
        self._known_codes: dict[tuple[Layout, str], NDArray[np.int32]] = {}
        self._finder = LayoutFinder(node, form, paths)

    def decode(self, block: Block) -> Columns:
        """Rows of a block."""
        groups, refused = self._finder.groups(block.buffer, block.starts, block.lengths)
        parts = [self._group(group) for group in groups]
        parts.append(Columns(np.empty(0, np.int64), refused=[(len(rows), why) for rows, why in refused]))
        return joined(parts) if refused or len(groups) != 1 else parts[0]

    def _group(self, group: Group) -> Columns:
        places, members, rows = group.layout.places, group.members, group.rows
        n_elements = 1
        if self._each_path is not None:
            n_elements = len(places.get(self._each_path, ()))
        n_rows = len(rows) * n_elements
        if n_elements == 0:
            return Columns(np.empty(0, np.int64))
        columns = Columns(members if n_elements == 1 else np.repeat(members, n_elements))
        for item in self._wanted.fields:
            paths = self._resolved.components.get(item.key)
            if paths is None:
                continue
            if any(path not in places for path in paths):
                if item.is_required:
                    why = f"its list is too short for field {item.paths[0]!r}"
                    return Columns(np.empty(0, np.int64), refused=[(len(rows), why)])
                self._leave_out(columns, item, n_rows)
                continue
            spread = [places[path] for path in paths]
            if item.form == "numbers":
                values = numbers(rows, [[part[i] for part in spread] for i in range(len(spread[0]))])
                if values.shape[1] != n_elements:
                    values = np.repeat(values, n_elements, axis=1)
                columns.numbers[item.key] = values.reshape(n_rows, -1)
            elif item.form == "stamp":
                stamps = seconds_and_nanoseconds(rows, *spread)
                if stamps.shape[1] != n_elements:
                    stamps = np.repeat(stamps, n_elements, axis=1)
                columns.stamps[item.key] = stamps.reshape(-1)
            else:
                columns.texts[item.key] = self._codes(group, item.key, spread[0], n_elements)
        return columns

    def _leave_out(self, columns: Columns, item: Field, n_rows: int) -> None:
        """Fill in a field that the type has and these messages do not reach, as others of the block may."""
        if item.form == "numbers":
            columns.numbers[item.key] = np.full((n_rows, max(len(item.labels), 1)), np.nan)
        elif item.form == "stamp":
            columns.stamps[item.key] = np.zeros(n_rows, np.int64)
        else:
            columns.texts[item.key] = np.full(n_rows, self._interner.code(""), np.int32)

    def _codes(self, group: Group, key: str, places: list[Place], n_elements: int) -> NDArray[np.int32]:
        """Codes of a text in each row; where all messages are worded alike, found once for their layout."""
        if not group.has_one_wording:
            return self._texts(group.rows, places, n_elements).reshape(-1)
        known = self._known_codes.get((group.layout, key))
        if known is None:
            known = self._texts(group.rows[:1], places, n_elements).reshape(-1)
            if len(self._known_codes) >= _MOST_CODES:
                self._known_codes.clear()
            self._known_codes[group.layout, key] = known
        return np.tile(known, len(group.rows))

    def _texts(self, rows: Bytes, places: list[Place], n_elements: int) -> NDArray[np.int32]:
        codes = np.empty((len(rows), n_elements), np.int32)
        for number, place in enumerate(places):
            target = slice(None) if len(places) != n_elements else slice(number, number + 1)
            if place.code == "S":
                found = self._interner.of_bytes(rows, place)
                codes[:, target] = found if isinstance(found, int) else found[:, None]
            else:
                values, which = np.unique(integers(rows, [place]), return_inverse=True)
                table = np.array([self._interner.code(str(int(value))) for value in values], np.int32)
                codes[:, target] = table[which.reshape(-1)][:, None]
        return codes
