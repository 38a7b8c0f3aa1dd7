"""Ground transitions to lifted ones: each distinct one once, with how often it was seen."""

from dataclasses import dataclass
from itertools import product
from typing import cast

import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.stages.learn.bind import HAND, OBJECT, Bindings
from demoplan.stages.learn.encode import NOBODY, Encoded, Ints, distinct
from demoplan.stages.learn.params import LearnParams
from demoplan.stages.learn.settle import FREE, GAP, Settled

BEFORE, AFTER = 0, 1
GRIPS = ("unknown", "free", "grasps", "holds", "releases", "exchanges")
_ANY, _GRIP, _SUPPORT = range(3)


@dataclass(frozen=True, order=True)
class LiftedAtom:
    """A predicate over variables, which are given by their position."""

    predicate: str
    variables: tuple[int, ...]


@dataclass(frozen=True)
class Pattern:
    """A distinct lifted transition.

    What is in neither set of a side was observed false; what is in both is likely true, and counts for no
    literal.
    """

    activity: str
    is_first: bool
    """Nothing came before it: the hand's track begins with it."""
    grip: str
    """What became of the hand's hold: one of ``GRIPS``."""
    types: tuple[str | None, ...]
    """Type of each variable's instance; null where the variable is not bound."""
    true: tuple[frozenset[LiftedAtom], frozenset[LiftedAtom]]
    """Atoms true before and after."""
    unknown: tuple[frozenset[LiftedAtom], frozenset[LiftedAtom]]
    count: int

    @property
    def is_uneventful(self) -> bool:
        """The track begins with it and nothing changes: it is a start and not a transition."""
        return self.is_first and self.true[BEFORE] == self.true[AFTER]


@dataclass(frozen=True)
class Lifted:
    """The distinct patterns, and which of them each transition shows."""

    variables: tuple[str, ...]
    patterns: tuple[Pattern, ...]
    pattern_of: Ints
    """Position of each transition's pattern, shape (n,)."""
    bindings: Ints
    """Instance codes, shape (n, number of variables)."""


def lift(data: Encoded, bindings: Bindings, settled: Settled | None, params: LearnParams) -> Lifted:
    """Replace bound instances by variables, drop every atom that mentions another, and count what is equal.

    Cost is linear in atoms; only distinct patterns reach Python objects.
    """
    base = len(bindings.variables) + 1
    width = data.atom_arguments.shape[1]
    # A lifted atom is one integer: its variables as digits, its predicate above them.
    weights = base ** np.arange(width + 1, dtype=np.int64)
    step = params.rows_per_chunk
    frame = pl.concat(
        [
            _signatures(
                data, bindings, settled, np.arange(start, min(start + step, data.n)), weights, params=params
            )
            for start in range(0, max(data.n, 1), step)
        ]
    )
    keys = [name for name in frame.columns if name != "row"]
    groups = (
        frame.group_by(keys, maintain_order=True)
        .agg("row")
        .with_columns(count=pl.col("row").list.len())
        .with_columns(text=pl.col("code").cast(pl.List(pl.String)).list.join(","))
        .sort(*keys[:-1], "text")
        .with_row_index("pattern")
    )
    of_row = groups.select("pattern", "row").explode("row").sort("row")["pattern"].to_numpy().astype(np.int64)
    patterns = tuple(
        _pattern(data, row, len(bindings.variables), weights, base)
        for row in groups.drop("row", "text").iter_rows(named=True)
    )
    return Lifted(bindings.variables, patterns, of_row, bindings.instances)


def _signatures(
    data: Encoded,
    bindings: Bindings,
    settled: Settled | None,
    rows: Ints,
    weights: Ints,
    *,
    params: LearnParams,
) -> pl.DataFrame:
    """One row per transition: activity, grip, types, and its lifted atoms as one sorted list of integers."""
    bound = bindings.instances[rows]
    grip_predicates = np.array([data.predicate_code(name) for name in (params.holding, params.empty)])
    places, codes = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for side, (is_unknown, states) in product((BEFORE, AFTER), enumerate((data.true, data.unknown))):
        own = 2 * rows + side
        hand = own if settled is None else settled.hand_source[rows, side]
        support = own if settled is None else settled.support_source[rows, side]
        for kind, source, subset in (
            (_ANY, own, np.arange(len(rows))),
            (_GRIP, hand, np.flatnonzero(hand != own)),
            (_SUPPORT, support, np.flatnonzero(support != own)),
        ):
            owner, atom = states.gather(source[subset])
            place, predicate, variables = _map_arguments(data, bound, subset[owner], atom)
            # What is said of the object alone, as that it is clear, changes with who holds it and not with
            # what it rests on.
            is_of_object = (variables[:, 0] == OBJECT) & (variables[:, 1:] == -1).all(axis=1)
            is_grip = (np.isin(predicate, grip_predicates) & (variables[:, 0] == HAND)) | is_of_object
            is_support = ((variables == -1) | (variables >= OBJECT)).all(axis=1) & (variables[:, 0] != -1)
            is_support &= ~is_of_object
            if kind == _ANY:
                keep = ~(is_grip & (hand != own)[place]) & ~(is_support & (support != own)[place])
            else:
                keep = is_grip if kind == _GRIP else is_support
            code = predicate[keep] * weights[-1] + (variables[keep] + 1) @ weights[:-1]
            places.append(place[keep])
            codes.append(code * 4 + side * 2 + is_unknown)
    place, code = np.concatenate(places), np.concatenate(codes)
    # One number for both: sorting it sorts by place, then by code.
    span = int(code.max(initial=0)) + 1
    place, code = np.divmod(distinct(place * span + code), span)
    atoms = pl.DataFrame({"place": place, "code": code}).group_by("place", maintain_order=True).agg("code")
    columns: dict[str, Ints | NDArray[np.bool_]] = {
        "place": np.arange(len(rows)),
        "row": rows,
        "activity": data.activity[rows],
        "is_first": data.is_first[rows],
        "grip": _grips(settled, rows),
    }
    for column in range(bound.shape[1]):
        columns[f"type_{column}"] = data.type_of(rows, bound[:, column])
    empty = pl.lit([], dtype=pl.List(pl.Int64))
    return (
        pl.DataFrame(columns)
        .join(atoms, on="place", how="left", maintain_order="left")
        .with_columns(pl.col("code").fill_null(empty))
        .drop("place")
    )


def _map_arguments(data: Encoded, bound: Ints, place: Ints, atom: Ints) -> tuple[Ints, Ints, Ints]:
    """Atoms over bound instances only, with their arguments as variable positions.

    An instance bound to two variables (``move a a``) gives an atom for each of them.

    Args:
        data: For the atoms' predicates and arguments.
        bound: Instances bound to each variable, shape (rows, variables).
        place: Row of each atom, shape (m,).
        atom: Atom codes, shape (m,).

    Returns:
        Row, predicate and variable positions (padded with −1) of each atom that is kept.
    """
    arguments = data.atom_arguments[atom]
    index = np.arange(len(atom))
    variables = np.full(arguments.shape, -1, dtype=np.int64)
    for column in range(arguments.shape[1]):
        argument = arguments[index, column]
        at = place[index]
        hits = [
            np.flatnonzero((instances[at] == argument) & (argument != NOBODY)) for instances in bound.T.copy()
        ]
        absent = np.flatnonzero(argument == NOBODY)
        chosen = np.concatenate([*hits, absent])
        variables = variables[chosen]
        variables[: len(chosen) - len(absent), column] = np.repeat(
            np.arange(len(hits)), [len(hit) for hit in hits]
        )
        index = index[chosen]
    return place[index], data.atom_predicate[atom[index]], variables


def _grips(settled: Settled | None, rows: Ints) -> Ints:
    if settled is None:
        return np.zeros(len(rows), dtype=np.int64)
    before, after = settled.holds[rows, 0], settled.holds[rows, 1]
    held_before, held_after = before >= 0, after >= 0
    return np.select(
        [
            (before == FREE) & (after == FREE),
            (before != GAP) & ~held_before & held_after,
            held_before & (before == after),
            held_before & ~held_after,
            held_before & held_after,
        ],
        [1, 2, 3, 4, 5],
        default=0,
    )


def _pattern(data: Encoded, row: dict[str, object], n_variables: int, weights: Ints, base: int) -> Pattern:
    sides: dict[int, set[LiftedAtom]] = {0: set(), 1: set(), 2: set(), 3: set()}
    for packed in cast("list[int]", row["code"]):
        code, place = divmod(packed, 4)
        predicate, rest = divmod(code, int(weights[-1]))
        variables = []
        while rest:
            rest, digit = divmod(rest, base)
            variables.append(digit - 1)
        sides[place].add(LiftedAtom(data.predicates[predicate].name, tuple(variables)))
    frozen = {place: frozenset(atoms) for place, atoms in sides.items()}
    types = [cast("int", row[f"type_{column}"]) for column in range(n_variables)]
    return Pattern(
        activity=data.activities[cast("int", row["activity"])],
        is_first=bool(row["is_first"]),
        grip=GRIPS[cast("int", row["grip"])],
        types=tuple(data.types[code] if code >= 0 else None for code in types),
        true=(frozen[0], frozen[2]),
        unknown=(frozen[1], frozen[3]),
        count=cast("int", row["count"]),
    )
