"""Learning from counts: each episode is looked at by itself, and what is found of many is added up.

What a transition is to learning depends on its own hand's episode, and on one thing that all data decide:
which activities usually make which change within themselves (the votes of ``settle``, of which only the order
counts). So votes are counted first, twice, since those on supports need settled hands; then every
transition becomes a ``Sightings`` row. Operators are made of patterns and how often each was seen.

All of these are counts of rows: in whatever order and parts episodes are taken, the sums are the same.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import dataframely as dy
import numpy as np
import polars as pl

from demoplan.ids import content_hash
from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy
from demoplan.stages.learn.bind import ROLES, bind_roles
from demoplan.stages.learn.encode import encode
from demoplan.stages.learn.learning import Learned, drafts_of_logs, tables_of
from demoplan.stages.learn.lift import AFTER, BEFORE, GRIPS, Lifted, LiftedAtom, Pattern, lift
from demoplan.stages.learn.mend import mend
from demoplan.stages.learn.params import LearnParams
from demoplan.stages.learn.settle import Votes as Ranks
from demoplan.stages.learn.settle import count_grip_votes, count_support_votes, settle
from demoplan.tables import Patterns, Sightings, Transitions, Votes
from demoplan.tables.validating import validated

_ATOMS = ("before", "after", "unknown_before", "unknown_after")


class Sighted(NamedTuple):
    """What some episodes show."""

    sightings: dy.DataFrame[Sightings]
    patterns: dy.DataFrame[Patterns]


def grip_votes(
    transitions: dy.DataFrame[Transitions],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    params: LearnParams = LearnParams(),
) -> dy.DataFrame[Votes]:
    """How often activities change what a hand holds within themselves."""
    return _votes(count_grip_votes(encode(transitions, types, predicates), params))


def support_votes(
    transitions: dy.DataFrame[Transitions],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    grip: Ranks,
    params: LearnParams = LearnParams(),
) -> dy.DataFrame[Votes]:
    """How often activities change what an object rests on within themselves, once hands are settled."""
    return _votes(count_support_votes(encode(transitions, types, predicates), types, params, grip))


def _votes(counts: Ranks) -> dy.DataFrame[Votes]:
    rows = [(*key, n) for key, n in sorted(counts.items())]
    return validated(pl.DataFrame(rows, schema=Votes.create_empty().schema, orient="row"), Votes)


def ranks(votes: Sequence[pl.DataFrame]) -> dict[tuple[str, int, int], int]:
    """Votes of many, added up, as the order that they put activities into: 1 for the fewest.

    More votes that leave the order as it was change nothing that follows from them.
    """
    rows = (
        pl.concat(votes)
        .group_by("activity", "old", "new")
        .agg(pl.col("n_transitions").sum())
        .filter(pl.col("n_transitions") > 0)
        .with_columns(rank=pl.col("n_transitions").rank("dense").over("old", "new").cast(pl.Int64))
        .sort("activity", "old", "new")
    )
    return {
        (activity, old, new): rank
        for activity, old, new, rank in rows.select("activity", "old", "new", "rank").iter_rows()
    }


def sight(
    transitions: dy.DataFrame[Transitions],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    grip: Ranks,
    support: Ranks,
    params: LearnParams = LearnParams(),
) -> Sighted:
    """The pattern that each transition of some episodes shows.

    Args:
        transitions: Of logs.
        types: The hierarchy that instances' types belong to.
        predicates: Every predicate that atoms may have.
        grip: Order of activities by ``grip_votes`` of all episodes.
        support: Order of activities by ``support_votes`` of all episodes.
        params: Learning choices.
    """
    data = encode(transitions, types, predicates)
    settled = settle(data, types, params, grip_votes=grip, support_votes=support)
    lifted = lift(data, bind_roles(data, settled, params), settled, params)
    patterns = _patterns_table(lifted.patterns)
    names = pl.Series(data.names, dtype=pl.String)
    bound = pl.DataFrame(
        [
            names.gather(pl.Series(f"_{place}", codes).replace(-1, None)).alias(f"_{place}")
            for place, codes in enumerate(lifted.bindings.T.copy())
        ]
    )
    rows = data.table.select("episode_id", "hand", "start_ns", "end_ns").with_columns(
        patterns["pattern"].gather(lifted.pattern_of),
        bound.select(binding=pl.concat_list(pl.all()))["binding"],
    )
    return Sighted(validated(rows, Sightings), validated(patterns.sort("pattern"), Patterns))


def _patterns_table(patterns: Sequence[Pattern]) -> pl.DataFrame:
    rows = []
    for each in patterns:
        atoms = [
            sorted(f"{atom.predicate}({','.join(map(str, atom.variables))})" for atom in group)
            for group in (each.true[BEFORE], each.true[AFTER], each.unknown[BEFORE], each.unknown[AFTER])
        ]
        said = (each.activity, each.is_first, each.grip, list(each.types), *atoms)
        rows.append((content_hash(repr(said))[:16], *said))
    return pl.DataFrame(rows, schema=Patterns.create_empty().schema, orient="row")


def learn_from_sightings(
    sightings: pl.DataFrame,
    patterns: pl.DataFrame,
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    params: LearnParams = LearnParams(),
) -> Learned:
    """Operators of what many episodes show: what ``learn`` gives for all their transitions at once.

    Readings are taken as they are; whether some are wrong so often that they need mending is for
    ``mend`` to say, which looks at transitions.

    Args:
        sightings: Of any number of episodes, in any order.
        patterns: What the sightings name; the same pattern may be there more than once.
        types: The hierarchy that instances' types belong to.
        predicates: Every predicate that atoms may have.
        params: Learning choices.
    """
    rows = sightings.sort("episode_id", "hand", "start_ns")
    known, found = _patterns_of(patterns, rows["pattern"], predicates)
    names = rows["binding"].explode().drop_nulls().unique().sort()
    bindings = np.stack(
        [
            rows["binding"]
            .list.get(place)
            .cast(pl.Enum(names))
            .to_physical()
            .cast(pl.Int64)
            .fill_null(-1)
            .to_numpy()
            for place in range(len(ROLES))
        ],
        axis=1,
    )
    place_of = rows["pattern"].cast(pl.Enum(known["pattern"])).to_physical().cast(pl.Int64).to_numpy()
    lifted = Lifted(ROLES, found, place_of, bindings)
    ordered = tuple(sorted(predicates))
    return tables_of(drafts_of_logs(lifted, types, ordered, params), rows, names.to_list(), lifted, params)


def count(sightings: pl.DataFrame) -> pl.DataFrame:
    """How many transitions and how many episodes show each pattern, sorted by pattern."""
    return (
        sightings.group_by("pattern")
        .agg(n_transitions=pl.len().cast(pl.Int64), n_episodes=pl.col("episode_id").n_unique().cast(pl.Int64))
        .sort("pattern")
    )


def _patterns_of(
    patterns: pl.DataFrame, seen: pl.Series, predicates: Sequence[Signature]
) -> tuple[pl.DataFrame, tuple[Pattern, ...]]:
    """Patterns that were seen, with how often, in the order in which ``lift`` gives them."""
    counts = seen.value_counts(name="n")
    rows = patterns.unique("pattern").join(counts, on="pattern")
    rows = rows.sort(
        "activity", "is_first", pl.col("grip").replace_strict(_GRIP_ORDER), _typed("types"), "pattern"
    )
    return rows, tuple(_pattern(row) for row in rows.iter_rows(named=True))


_GRIP_ORDER = {name: code for code, name in enumerate(GRIPS)}


def _typed(column: str) -> pl.Expr:
    return pl.col(column).list.eval(pl.element().fill_null("")).list.join("\0")


def _pattern(row: Mapping[str, object]) -> Pattern:
    before, after, unknown_before, unknown_after = (
        frozenset(_atom(text) for text in row[name])  # type: ignore[attr-defined]
        for name in _ATOMS
    )
    return Pattern(
        activity=str(row["activity"]),
        is_first=bool(row["is_first"]),
        grip=str(row["grip"]),
        types=tuple(row["types"]),  # type: ignore[arg-type]
        true=(before, after),
        unknown=(unknown_before, unknown_after),
        count=int(row["n"]),  # type: ignore[call-overload]
    )


def _atom(text: str) -> LiftedAtom:
    name, _, rest = text.partition("(")
    return LiftedAtom(name, tuple(int(each) for each in rest[:-1].split(",") if each))


def needs_mending(
    transitions: dy.DataFrame[Transitions],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    params: LearnParams = LearnParams(),
) -> bool:
    """Whether readings are wrong so often that they are to be mended, all together, before counting."""
    return mend(encode(transitions, types, predicates), types, params.mend).is_needed
