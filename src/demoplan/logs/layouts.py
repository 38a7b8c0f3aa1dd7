"""Serialised messages to columns: messages of equal layout are read as one byte matrix.

Where a field of a message lies depends on the lengths of the strings and lists before it, and on nothing
else. So messages of one type are grouped by their own length and these lengths; each group is a matrix with
one row per message, of which a field is some columns. Layouts repeat: once found, they are recognised in
later messages by comparing the lengths where they stand. One walk through the type is made per layout, not
per message.

Source: OMG, "DDS Interoperability Wire Protocol" 2.5, section 10 (CDR, XCDR1 alignment);
http://wiki.ros.org/ROS/Connection%20Header and genpy's serialisation (ROS 1: packed, little-endian).
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from demoplan.logs.definitions import Node, Number, Record, Repeated, Text
from demoplan.logs.messages import Bytes, Times, stretches

EACH = "*"
"""Path step into every element of a list."""

Step: TypeAlias = str | int
Path: TypeAlias = tuple[Step, ...]

_NANOSECONDS_PER_SECOND = 1_000_000_000
_MOST_LAYOUTS = 64
"""Layouts that are remembered for one length of message; then the oldest is forgotten."""


@dataclass(frozen=True)
class Place:
    """Where a value lies in each message of a layout: first byte, and dtype code or number of text bytes."""

    start: int
    code: str
    n_bytes: int


@dataclass(frozen=True, eq=False)
class Layout:
    """Where everything wanted lies, in messages that have these lengths at these places."""

    conditions: tuple[tuple[int, str, int], ...]
    """(first byte, dtype code, value) of every length that decides the layout."""
    places: dict[Path, list[Place]]
    """Places of each path; one per element where the path goes into each element of a list."""
    n_bytes: int
    """Length of these messages."""

    @cached_property
    def mask(self) -> Bytes:
        """255 at every byte of a deciding length or a wanted text, else 0 ``(n_bytes,)``."""
        covered = np.zeros(self.n_bytes, np.uint8)
        for start, _, _ in self.conditions:
            covered[start : start + 4] = 255
        for places in self.places.values():
            for place in places:
                if place.code == "S":
                    covered[place.start : place.start + place.n_bytes] = 255
        return covered


@dataclass(frozen=True, eq=False)
class Group:
    """Messages of one layout."""

    layout: Layout
    members: Times
    """Which messages of those that were asked about ``(m,)``."""
    rows: Bytes
    """Their bytes ``(m, length)``."""
    has_one_wording: bool = False
    """All have the texts of the layout's first message, at every wanted place."""


class MalformedError(Exception):
    """Messages that do not hold what their type says."""


class _SplitError(Exception):
    """The messages of a group differ in a length: they are several groups."""

    def __init__(self, values: NDArray[np.uint32]) -> None:
        self.values = values


@dataclass(frozen=True)
class Format:
    """How a serialisation lays out fields."""

    origin: int
    """Bytes before the message's body."""
    is_aligned: bool
    """Numbers stand at multiples of their size from the origin, and texts end in a zero byte (CDR)."""


CDR = Format(origin=4, is_aligned=True)
ROS1 = Format(origin=0, is_aligned=False)

Trie: TypeAlias = dict[Step, "Trie"]


def trie_of(paths: list[Path]) -> Trie:
    """Wanted paths as a tree; an empty one is a leaf."""
    root: Trie = {}
    for path in paths:
        node = root
        for step in path:
            node = node.setdefault(step, {})
    return root


class _Walk:
    """One walk through a type, asking for the lengths on the way."""

    def __init__(self, form: Format, order: str, length: int, ask: Callable[[int], int]) -> None:
        self.form = form
        self.order = order
        self.length = length
        self.ask = ask
        self.conditions: list[tuple[int, str, int]] = []
        self.places: dict[Path, list[Place]] = {}

    def take(self, n_bytes: int, at: int, align: int) -> int:
        """Start of ``n_bytes`` bytes that follow ``at``, in body coordinates."""
        if self.form.is_aligned and align > 1:
            at += -at % align
        if at + n_bytes + self.form.origin > self.length:
            raise MalformedError(f"a message of {self.length} bytes ends within a field")
        return at

    def size(self, at: int) -> tuple[int, int]:
        """A length that the messages state, and where what follows it begins."""
        at = self.take(4, at, 4)
        place = at + self.form.origin
        value = self.ask(place)
        self.conditions.append((place, self.order + "u4", value))
        if value > self.length:
            raise MalformedError(f"a message of {self.length} bytes states a length of {value}")
        return value, at + 4

    def node(self, node: Node, wanted: Trie | None, path: Path, at: int, is_end_needed: bool) -> int:
        """Note the wanted places within a node; gives where it ends."""
        if isinstance(node, Number):
            at = self.take(node.size, at, node.size)
            if wanted is not None:
                place = Place(at + self.form.origin, self.order + node.code, node.size)
                self.places.setdefault(path, []).append(place)
            return at + node.size
        if isinstance(node, Text):
            return self._text(node, wanted, path, at)
        if isinstance(node, Record):
            return self._record(node, wanted, path, at, is_end_needed)
        return self._repeated(node, wanted, path, at, is_end_needed)

    def _text(self, node: Text, wanted: Trie | None, path: Path, at: int) -> int:
        if node.is_wide:
            raise MalformedError("it has a wide string, whose layout is not standardised")
        n_bytes, at = self.size(at)
        self.take(n_bytes, at, 1)
        if wanted is not None:
            n_text = n_bytes - 1 if self.form.is_aligned and n_bytes else n_bytes
            self.places.setdefault(path, []).append(Place(at + self.form.origin, "S", n_text))
        return at + n_bytes

    def _record(self, node: Record, wanted: Trie | None, path: Path, at: int, is_end_needed: bool) -> int:
        n_left = len(wanted) if wanted else 0
        for name, child in node.fields:
            if n_left == 0 and not is_end_needed:
                break
            inner = None if wanted is None else wanted.get(name)
            if inner is not None:
                n_left -= 1
            at = self.node(child, inner, (*path, name), at, is_end_needed or n_left > 0)
        return at

    def _repeated(self, node: Repeated, wanted: Trie | None, path: Path, at: int, is_end_needed: bool) -> int:
        count = node.count
        if count is None:
            count, at = self.size(at)
        element = node.element
        if isinstance(element, Number):
            if count == 0:
                return at
            at = self.take(count * element.size, at, element.size)
            for step in wanted or ():
                if isinstance(step, int) and step < count:
                    start = at + step * element.size + self.form.origin
                    self.places.setdefault((*path, step), []).append(
                        Place(start, self.order + element.code, element.size)
                    )
            return at + count * element.size
        if count > self.length:
            raise MalformedError(f"a message of {self.length} bytes states a list of {count} elements")
        each = None if wanted is None else wanted.get(EACH)
        last = max((step for step in wanted or () if isinstance(step, int)), default=-1)
        for number in range(count):
            inner = each
            place: Step = EACH
            if inner is None and wanted is not None and number in wanted:
                inner, place = wanted[number], number
            is_last = number == count - 1
            needed = is_end_needed or (not is_last and (each is not None or number < last))
            before = at
            at = self.node(element, inner, (*path, place), at, needed)
            if inner is None and number > last and at == before:
                break  # Elements without a byte: as many as one likes.
            if not is_end_needed and each is None and number >= last >= 0:
                break
        return at


class LayoutFinder:
    """Finds the layouts of messages of one type, and remembers them."""

    def __init__(self, node: Record, form: Format, paths: list[Path]) -> None:
        """Take a type, its serialisation, and what is wanted of it."""
        self._node = node
        self._form = form
        self._wanted = trie_of(paths)
        self._known: dict[tuple[int, str], list[Layout]] = {}
        self._wordings: dict[Layout, Bytes] = {}
        self._extent = self._fixed_extent()

    def _fixed_extent(self) -> int | None:
        """How many first bytes hold everything wanted, if no length comes before any of it."""

        def ask(_: int) -> int:
            raise _SplitError(np.empty(0, np.uint32))

        walk = _Walk(self._form, "<", 2**31, ask)
        try:
            walk.node(self._node, self._wanted, (), 0, False)
        except (_SplitError, MalformedError):
            return None
        ends = [place.start + place.n_bytes for places in walk.places.values() for place in places]
        return max(ends, default=self._form.origin + 1)

    def groups(
        self, buffer: Bytes, starts: Times, lengths: Times
    ) -> tuple[list[Group], list[tuple[Times, str]]]:
        """Messages by layout.

        Args:
            buffer: Holds the payloads.
            starts: First byte of each payload ``(n,)``.
            lengths: Bytes of each payload ``(n,)``.

        Returns:
            Groups of messages; and messages that do not hold what their type says, with what is wrong.
        """
        groups: list[Group] = []
        refused: list[tuple[Times, str]] = []
        if self._extent is not None:
            # What comes after does not matter: messages of any length have one layout.
            lengths = np.minimum(lengths, self._extent)
        first = int(lengths[0]) if len(lengths) else 0
        is_one_length = bool((lengths == first).all())
        for length in [first] if is_one_length else np.unique(lengths).tolist():
            members = np.arange(len(lengths)) if is_one_length else np.flatnonzero(lengths == length)
            if not len(members):
                continue
            if length <= self._form.origin:
                refused.append((members, f"a message of {length} bytes is empty"))
                continue
            rows = _rows(buffer, starts if is_one_length else starts[members], length)
            for order, kept, problem in self._orders(rows):
                if problem:
                    refused.append((members[kept], problem))
                else:
                    self._of_length(rows, members, kept, length, order, groups, refused)
        return groups, refused

    def _orders(self, rows: Bytes) -> list[tuple[str, Times, str]]:
        """(byte order, which rows, what is wrong with them) by the header that CDR begins with."""
        everything = np.arange(len(rows))
        if not self._form.is_aligned:
            return [("<", everything, "")]
        kinds = rows[:, 0].astype(np.int64) * 256 + rows[:, 1]
        found = []
        for kind in [int(kinds[0])] if (kinds == kinds[0]).all() else np.unique(kinds).tolist():
            kept = everything[kinds == kind]
            problem = (
                "" if kind in (0, 1) else f"encapsulation 0x{kind:04x} is not plain CDR (0x0000, 0x0001)"
            )
            found.append(("<" if kind == 1 else ">", kept, problem))
        return found

    def _of_length(
        self,
        rows: Bytes,
        members: Times,
        kept: Times,
        length: int,
        order: str,
        groups: list[Group],
        refused: list[tuple[Times, str]],
    ) -> None:
        known = self._known.setdefault((length, order), [])
        if len(kept) == len(rows):
            for layout in known:
                if self._has_wording(rows, layout):
                    groups.append(Group(layout, members, rows, has_one_wording=True))
                    return
        for layout in known:
            if not len(kept):
                return
            is_such = _fits(rows, kept, layout)
            if is_such.all():
                groups.append(Group(layout, members[kept], rows if len(kept) == len(rows) else rows[kept]))
                return
            if is_such.any():
                groups.append(Group(layout, members[kept[is_such]], rows[kept[is_such]]))
                kept = kept[~is_such]
        pending = [kept] if len(kept) else []
        while pending:
            group = pending.pop()
            try:
                layout = self._discover(rows, group, length, order)
            except _SplitError as split:
                values, which = np.unique(split.values, return_inverse=True)
                by_value = np.argsort(which, kind="stable")
                bounds = np.searchsorted(which[by_value], np.arange(1, len(values)))
                pending += [group[part] for part in np.split(by_value, bounds)]
            except MalformedError as error:
                refused.append((members[group], str(error)))
            else:
                groups.append(Group(layout, members[group], rows if len(group) == len(rows) else rows[group]))
                known.append(layout)
                for forgotten in known[:-_MOST_LAYOUTS]:
                    self._wordings.pop(forgotten, None)
                del known[:-_MOST_LAYOUTS]

    def _has_wording(self, rows: Bytes, layout: Layout) -> bool:
        """Whether all rows have the lengths of a layout, and the texts that its first message had.

        These bytes are constant as long as the same frames are published. Comparing whole rows under a mask
        costs a fraction of looking at each length and text by itself.
        """
        wording = self._wordings.get(layout)
        if wording is None:
            if not _fits(rows[:1], np.zeros(1, np.int64), layout).all():
                return False
            wording = self._wordings[layout] = rows[0].copy()
        differences = rows ^ wording
        differences &= layout.mask
        return int(differences.max()) == 0

    def _discover(self, rows: Bytes, group: Times, length: int, order: str) -> Layout:
        """The layout that all rows of a group have."""

        def ask(place: int) -> int:
            values = rows[group, place : place + 4].view(order + "u4")[:, 0]
            if (values != values[0]).any():
                raise _SplitError(values)
            return int(values[0])

        walk = _Walk(self._form, order, length, ask)
        walk.node(self._node, self._wanted, (), 0, False)
        return Layout(tuple(walk.conditions), walk.places, length)


def _fits(rows: Bytes, kept: Times, layout: Layout) -> NDArray[np.bool_]:
    """Which of the kept rows have the lengths of a layout."""
    chosen = rows if len(kept) == len(rows) else rows[kept]
    is_such = np.ones(len(chosen), bool)
    for place, code, value in layout.conditions:
        is_such &= chosen[:, place : place + 4].view(code)[:, 0] == value
        if not is_such.any():
            break
    return is_such


def _rows(buffer: Bytes, starts: Times, length: int) -> Bytes:
    """Payloads of one length as a matrix ``(n, length)``: a view if they are evenly spaced, else a copy."""
    if len(starts) > 1:
        stride = int(starts[1] - starts[0])
        if stride >= length and (np.diff(starts) == stride).all():
            return np.lib.stride_tricks.as_strided(
                buffer[int(starts[0]) :], (len(starts), length), (stride, 1), writeable=False
            )
    return stretches(buffer, starts, length)


def numbers(rows: Bytes, places: list[list[Place]]) -> NDArray[np.float64]:
    """Values ``(n, elements, components)`` as floats; ``places`` holds a list per element."""
    n_elements, width = len(places), len(places[0]) if places else 0
    values = np.empty((len(rows), n_elements, width))
    for number, components in enumerate(places):
        first = components[0]
        size = first.n_bytes
        is_run = all(
            place.code == first.code and place.start == first.start + i * size
            for i, place in enumerate(components)
        )
        if is_run:
            run = rows[:, first.start : first.start + width * size]
            if first.code == "<f8":
                # Moving raw bytes is faster than moving doubles that are not aligned.
                values[:, number].view(f"V{8 * width}")[:, 0] = run.view(f"V{8 * width}")[:, 0]
            else:
                values[:, number] = run.view(first.code)
        else:
            for i, place in enumerate(components):
                values[:, number, i] = rows[:, place.start : place.start + place.n_bytes].view(place.code)[
                    :, 0
                ]
    return values


def seconds_and_nanoseconds(rows: Bytes, seconds: list[Place], nanoseconds: list[Place]) -> Times:
    """Stamps ``(n, elements)`` in nanoseconds."""
    if all(
        first.n_bytes == second.n_bytes == 4 and second.start == first.start + 4
        for first, second in zip(seconds, nanoseconds, strict=True)
    ):
        # As they stand side by side, both are moved at once.
        pairs = np.empty((len(rows), len(seconds)), "V8")
        for number, place in enumerate(seconds):
            pairs[:, number] = rows[:, place.start : place.start + 8].view("V8")[:, 0]
        parts = pairs.view(np.uint8).reshape(len(rows), len(seconds), 2, 4)
        return parts[:, :, 0].view(seconds[0].code)[..., 0] * np.int64(_NANOSECONDS_PER_SECOND) + parts[
            :, :, 1
        ].view(nanoseconds[0].code)[..., 0].astype(np.int64)
    return integers(rows, seconds) * _NANOSECONDS_PER_SECOND + integers(rows, nanoseconds)


def integers(rows: Bytes, places: list[Place]) -> Times:
    """Whole numbers ``(n, elements)``."""
    values = np.empty((len(rows), len(places)), np.int64)
    for number, place in enumerate(places):
        values[:, number] = rows[:, place.start : place.start + place.n_bytes].view(place.code)[:, 0]
    return values


class Interner:
    """Texts that repeat, as numbers."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self._codes: dict[str, int] = {}

    def code(self, text: str) -> int:
        """The number of a text, the same each time."""
        code = self._codes.setdefault(text, len(self.texts))
        if code == len(self.texts):
            self.texts.append(text)
        return code

    def of_bytes(self, rows: Bytes, place: Place) -> NDArray[np.int32] | int:
        """Numbers of the texts at a place ``(n,)``; a single one where all rows have the same."""
        if place.n_bytes == 0:
            return self.code("")
        column = rows[:, place.start : place.start + place.n_bytes]
        first = column[0].tobytes()
        if _is_constant(column, first):
            return self.code(_decoded(first))
        texts, which = np.unique(
            np.ascontiguousarray(column).view(f"S{place.n_bytes}")[:, 0], return_inverse=True
        )
        codes = np.array([self.code(_decoded(bytes(text))) for text in texts], np.int32)
        return codes[which]


def _decoded(text: bytes) -> str:
    return text.rstrip(b"\0").decode(errors="replace")


def _is_constant(column: Bytes, first: bytes) -> bool:
    """Whether all rows hold the same bytes; compared by words, since rows are long and texts short."""
    at, n_bytes = 0, len(first)
    while at < n_bytes:
        width = next(width for width in (8, 4, 2, 1) if width <= n_bytes - at)
        word = int.from_bytes(first[at : at + width], "little")
        if (column[:, at : at + width].view(f"<u{width}")[:, 0] != word).any():
            return False
        at += width
    return True
