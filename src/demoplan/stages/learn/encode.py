"""Transitions as integer arrays: what the vectorised steps of learning work on."""

from collections.abc import Sequence
from dataclasses import dataclass

import dataframely as dy
import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.errors import DataError, UnknownNameError
from demoplan.language.atoms import Atom
from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy
from demoplan.tables import Transitions

Ints = NDArray[np.int64]
Codes = NDArray[np.int32]
"""Where there are very many of them."""
NOBODY = -1
"""Code where no instance stands."""


_ROWS_AT_ONCE = 100_000
"""Rows whose states are taken apart together: bounds memory."""


def distinct(values: Ints) -> Ints:
    """Sorted, each once: many times as fast as by hashing where nearly all are distinct."""
    ordered = np.sort(values)
    return np.asarray(ordered[np.r_[True, ordered[1:] != ordered[:-1]][: len(ordered)]])


@dataclass(frozen=True)
class States:
    """Atom codes of every state, one after the other: state ``i`` is ``atoms[offsets[i]:offsets[i + 1]]``.

    State ``2 r`` is the one before transition ``r``, ``2 r + 1`` the one after it.
    """

    offsets: Ints
    atoms: Codes

    def only(self, is_wanted: NDArray[np.bool_]) -> "States":
        """The same states with none but the wanted atoms; ``is_wanted`` says which by atom code."""
        keep = is_wanted[self.atoms]
        return States(
            np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(keep)])[self.offsets], self.atoms[keep]
        )

    def gather(self, states: Ints) -> tuple[Ints, Ints]:
        """Which of ``states`` (by position) each atom belongs to, and the atom's code."""
        first = self.offsets[states]
        count = self.offsets[states + 1] - first
        owner = np.repeat(np.arange(len(states)), count)
        position = np.arange(len(owner)) - np.repeat(np.cumsum(count) - count, count)
        return owner, self.atoms[position + np.repeat(first, count)].astype(np.int64)


@dataclass(frozen=True)
class Encoded:
    """Transitions, sorted by episode, hand and start; instances, activities and atoms are codes."""

    table: pl.DataFrame
    """The transitions themselves in that order, without their states."""
    sequence: Ints
    """Which (episode, hand) each belongs to, shape (n,); rows of one sequence follow each other."""
    duration_ns: Ints
    is_first: NDArray[np.bool_]
    """No activity of its hand came before."""
    activity: Ints
    activities: tuple[str, ...]
    hand: Ints
    acted_on: Ints
    in_hand: Ints
    arguments: Ints | None
    """Instances that a symbolic trace's action names, shape (n, k), padded with ``NOBODY``; null for logs."""
    names: tuple[str, ...]
    """Instances, by code."""
    types: tuple[str, ...]
    """Types, by code."""
    _type_keys: Ints
    _type_codes: Ints
    episode: Ints
    """Code of each transition's episode, shape (n,)."""
    predicates: tuple[Signature, ...]
    """By code."""
    atom_predicate: Ints
    atom_arguments: Ints
    """Instance codes, shape (n atoms, most arguments), padded with ``NOBODY``."""
    true: States
    unknown: States

    def has_predicate(self, *names: str) -> NDArray[np.bool_]:
        """Whether each atom, by code, is of one of these predicates."""
        return np.isin(self.atom_predicate, [self.predicate_code(name) for name in names])

    @property
    def n(self) -> int:
        """How many transitions there are."""
        return len(self.activity)

    def predicate_code(self, name: str) -> int:
        """Code of a predicate, or −1 if the vocabulary does not have it."""
        return next((code for code, each in enumerate(self.predicates) if each.name == name), -1)

    def objects_of(self, episode: int) -> tuple[Ints, Ints]:
        """Instances of an episode, and the type of each, as codes; shapes (k,)."""
        low, high = np.searchsorted(
            self._type_keys, np.array([episode, episode + 1]) * max(len(self.names), 1)
        )
        return self._type_keys[low:high] % max(len(self.names), 1), self._type_codes[low:high]

    def type_of(self, rows: Ints, instances: Ints) -> Ints:
        """Type codes of instances in the episodes of rows; −1 for ``NOBODY``. Shapes (m,)."""
        keys = self.episode[rows] * len(self.names) + instances
        found = np.minimum(np.searchsorted(self._type_keys, keys), len(self._type_keys) - 1)
        known = (instances != NOBODY) & (self._type_keys[found] == keys)
        missing = np.flatnonzero(~known & (instances != NOBODY))
        if len(missing):
            row, name = int(rows[missing[0]]), self.names[instances[missing[0]]]
            raise DataError(
                f"object {name!r} of episode {self.table['episode_id'][row]!r} has no type: it is not "
                f"among the transition's objects"
            )
        return np.where(known, self._type_codes[found], -1)


def encode(
    transitions: dy.DataFrame[Transitions], types: TypeHierarchy, predicates: Sequence[Signature]
) -> Encoded:
    """Transitions with every name replaced by a code; codes follow the names' order.

    Raises:
        UnknownNameError: If an atom's predicate or an object's type is unknown.
        DataError: If an atom has the wrong number of arguments.
    """
    table = _sorted(transitions)
    ordered = tuple(sorted(predicates))
    atom_names = pl.concat(
        [
            part[column].explode().drop_nulls().unique()
            for part in table.iter_slices(_ROWS_AT_ONCE)
            for column in ("before", "after", "unknown_before", "unknown_after")
        ]
        or [pl.Series(dtype=pl.String)]
    )
    atom_names = atom_names.unique().sort()
    atoms = [Atom.parse(text) for text in atom_names]
    _require_signatures(atoms, ordered)
    mentioned = pl.concat(
        [
            pl.Series([name for atom in atoms for name in atom.arguments], dtype=pl.String),
            *(table[column].drop_nulls() for column in ("hand", "acted_on", "in_hand")),
            table["arguments"].explode().drop_nulls(),
        ]
    )
    objects = (
        table.group_by("episode_id", maintain_order=True)
        .agg(pl.col("objects").first())
        .explode("objects")
        .unnest("objects")
        .drop_nulls("name")
    )
    names = pl.concat([mentioned, objects["name"]]).unique().sort()
    code_of = {name: code for code, name in enumerate(names)}
    for name in objects["type"].unique().sort():
        types.require(name)
    type_names = objects["type"].unique().sort()
    widest = max((len(atom.arguments) for atom in atoms), default=0)
    arguments = np.full((len(atoms), max(widest, 2)), NOBODY, dtype=np.int64)
    for row, atom in enumerate(atoms):
        for column, name in enumerate(atom.arguments):
            arguments[row, column] = code_of[name]
    predicate_code = {signature.name: code for code, signature in enumerate(ordered)}
    episodes = table["episode_id"].unique().sort()
    keys = _codes(objects["episode_id"], episodes) * len(names) + _codes(objects["name"], names)
    order = np.argsort(keys, kind="stable")
    activities = table["activity"].unique().sort()
    changed = (table["episode_id"] != table["episode_id"].shift()) | (table["hand"] != table["hand"].shift())
    has_no_arguments = table["arguments"].is_null()
    has_arguments = table.height > 0 and table["arguments"].null_count() < table.height
    return Encoded(
        table=table.drop("before", "after", "unknown_before", "unknown_after", "objects"),
        sequence=changed.fill_null(True).cum_sum().to_numpy().astype(np.int64),
        duration_ns=(table["end_ns"] - table["start_ns"]).to_numpy(),
        is_first=changed.fill_null(True).to_numpy() & has_no_arguments.to_numpy(),
        activity=_codes(table["activity"], activities),
        activities=tuple(activities),
        hand=_codes(table["hand"], names),
        acted_on=_codes(table["acted_on"], names),
        in_hand=_codes(table["in_hand"], names),
        arguments=_argument_codes(table["arguments"], names) if has_arguments else None,
        names=tuple(names),
        types=tuple(type_names),
        _type_keys=keys[order],
        _type_codes=_codes(objects["type"], type_names)[order],
        episode=_codes(table["episode_id"], episodes),
        predicates=ordered,
        atom_predicate=np.array([predicate_code[atom.predicate] for atom in atoms], dtype=np.int64),
        atom_arguments=arguments,
        true=_states(table["before"], table["after"], atom_names),
        unknown=_states(table["unknown_before"], table["unknown_after"], atom_names),
    )


def _sorted(transitions: pl.DataFrame) -> pl.DataFrame:
    """By episode, hand and start; without a copy where they are so already."""
    order = transitions.select(pl.arg_sort_by("episode_id", "hand", "start_ns")).to_series()
    is_sorted = bool((order == pl.int_range(len(order), eager=True)).all())
    return transitions if is_sorted else transitions[order]


def _require_signatures(atoms: Sequence[Atom], predicates: Sequence[Signature]) -> None:
    arity = {signature.name: len(signature.argument_types) for signature in predicates}
    for atom in atoms:
        if atom.predicate not in arity:
            raise UnknownNameError("predicate", atom.predicate, arity, "the vocabulary")
        if len(atom.arguments) != arity[atom.predicate]:
            raise DataError(
                f"atom {atom} has {len(atom.arguments)} arguments; predicate {atom.predicate!r} takes "
                f"{arity[atom.predicate]}"
            )


def _codes(values: pl.Series, names: pl.Series) -> Ints:
    """Position of each value among sorted names; ``NOBODY`` for null."""
    if not len(names):
        return np.full(len(values), NOBODY, dtype=np.int64)
    physical = values.cast(pl.Enum(names), strict=False).to_physical().cast(pl.Int64)
    return physical.fill_null(NOBODY).to_numpy().copy()


def _argument_codes(arguments: pl.Series, names: pl.Series) -> Ints:
    counts = arguments.list.len().fill_null(0).to_numpy().astype(np.int64)
    codes = np.full((len(arguments), int(counts.max(initial=0))), NOBODY, dtype=np.int64)
    flat = _codes(arguments.explode().drop_nulls(), names)
    row = np.repeat(np.arange(len(counts)), counts)
    column = np.arange(len(flat)) - np.repeat(np.cumsum(counts) - counts, counts)
    codes[row, column] = flat
    return codes


def _states(before: pl.Series, after: pl.Series, atoms: pl.Series) -> States:
    n = len(before)
    counts = np.empty(2 * n, dtype=np.int64)
    for side, lists in enumerate((before, after)):
        counts[side::2] = lists.list.len().fill_null(0).to_numpy()
    offsets = np.concatenate([np.zeros(1, dtype=np.int64), np.cumsum(counts)])
    flat = np.empty(int(offsets[-1]), dtype=np.int32)
    for start in range(0, n, _ROWS_AT_ONCE):
        end = min(start + _ROWS_AT_ONCE, n)
        for side, lists in enumerate((before, after)):
            own = counts[2 * start + side : 2 * end : 2]
            first = offsets[2 * start + side : 2 * end : 2]
            position = np.arange(own.sum()) + np.repeat(first - (np.cumsum(own) - own), own)
            flat[position] = _codes(lists[start:end].explode().drop_nulls(), atoms)
    return States(offsets, flat)
