"""Activities and facts to transitions: what each activity changed."""

from collections.abc import Mapping
from dataclasses import dataclass

import dataframely as dy
import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.errors import DataError, UnknownNameError
from demoplan.tables import Activities, Facts, Transitions
from demoplan.tables.validating import validated

Ints = NDArray[np.int64]
_TRACK = ["episode_id", "hand"]


@dataclass(frozen=True, kw_only=True)
class ContrastParams:
    """What can be chosen about contrasting."""

    predominant: tuple[str, ...] = ("handMove",)
    """Predicates that say how a hand moves *during* an activity. Their value is what held for most of it: as
    it ends they are about to change, and on which side of the end they do is chance."""


def contrast(
    activities: dy.DataFrame[Activities],
    facts: dy.DataFrame[Facts],
    entities: Mapping[str, str],
    params: ContrastParams = ContrastParams(),
) -> dy.DataFrame[Transitions]:
    """The transition into each activity, with the atoms that held before and after it.

    ``after`` is the state at the end of the activity, ``before`` at the end of the hand's previous one.
    The first activity of a hand has no previous one: its ``before`` is the state at its own first tick, and
    its ``previous_activity`` is null. The state at an end is the last that was seen *within* the
    segment: an atom that begins with the next segment is not in it, one that ends with this segment is.

    Args:
        activities: Stretches that tile each hand's episode, in any row order.
        facts: Intervals of ground atoms, on the same clock.
        entities: Type of each instance, as the dataset's mapping gives it.
        params: Which predicates count by the time that they held.

    Returns:
        One row per activity, sorted by episode, hand and start.

    Raises:
        UnknownNameError: If an activity or a fact names an instance that ``entities`` does not have.
        DataError: If a hand's activities overlap, or leave a gap.
    """
    _require_known(activities, facts, entities)
    if activities.is_empty():
        return Transitions.create_empty()
    rows = activities.sort([*_TRACK, "start_ns"]).with_columns(
        previous_activity=pl.col("activity").shift().over(_TRACK),
        previous_end_ns=pl.col("end_ns").shift().over(_TRACK),
    )
    _require_tiles(rows)
    atoms = facts.with_columns(
        atom=pl.format("{}({})", "predicate", pl.col("arguments").list.join(",")),
        is_predominant=pl.col("predicate").is_in(params.predominant),
    ).drop("predicate", "arguments")
    first = rows["previous_activity"].is_null()
    ends = _at_instants(atoms.filter(~pl.col("is_predominant")), rows["episode_id"], rows["end_ns"])
    during = _predominant(atoms.filter("is_predominant"), rows)
    after = _states(pl.concat([ends, during]), rows.height)
    firsts = rows.filter(first).join(
        facts.group_by("episode_id").agg(seen_ns=pl.col("start_ns").min()),
        on="episode_id",
        how="left",
        maintain_order="left",
    )
    # The left limit one nanosecond later is the first tick itself; labels may begin before anything was seen.
    instants = firsts.select(pl.max_horizontal("start_ns", "seen_ns") + 1).to_series()
    starts = _at_instants(atoms, firsts["episode_id"], instants)
    places = pl.DataFrame({"place": np.flatnonzero(first)}).with_row_index("row").cast(pl.Int64)
    start = _states(starts.join(places, on="row").select("atom", "value", row="place"), rows.height)
    before = {
        value: pl.select(pl.when(first).then(start[value]).otherwise(after[value].shift())).to_series()
        for value in ("true", "unknown")
    }
    objects = [{"name": name, "type": entities[name]} for name in sorted(entities)]
    table = rows.select(
        *_TRACK,
        "start_ns",
        "end_ns",
        "activity",
        "previous_activity",
        pl.lit(None, dtype=pl.List(pl.String)).alias("arguments"),
        "acted_on",
        "in_hand",
        pl.lit(pl.Series([objects], dtype=Transitions.create_empty().schema["objects"]))
        .first()
        .alias("objects"),
        before["true"].alias("before"),
        after["true"].alias("after"),
        before["unknown"].alias("unknown_before"),
        after["unknown"].alias("unknown_after"),
    )
    return validated(table, Transitions)


def _require_known(
    activities: dy.DataFrame[Activities], facts: dy.DataFrame[Facts], entities: Mapping[str, str]
) -> None:
    named = pl.concat(
        [activities[column] for column in ("hand", "acted_on", "in_hand")] + [facts["arguments"].explode()]
    )
    for name in named.drop_nulls().unique().sort():
        if name not in entities:
            raise UnknownNameError("instance", name, entities, "the mapping's entities")


def _require_tiles(rows: pl.DataFrame) -> None:
    apart = rows.filter(pl.col("previous_end_ns") != pl.col("start_ns"))
    if not apart.is_empty():
        first = apart.row(0, named=True)
        raise DataError(
            f"activities of hand {first['hand']!r} in {first['episode_id']!r} do not tile it: one starts "
            f"at {first['start_ns']} ns, the previous one ends at {first['previous_end_ns']} ns"
        )


def _at_instants(facts: pl.DataFrame, episodes: pl.Series, instants: pl.Series) -> pl.DataFrame:
    """Atoms that held, or were unknown, in the left limit of each instant.

    Args:
        facts: Intervals ``[start, end)``; one holds in the left limit of ``t`` when ``start < t <= end``.
        episodes: Episode of each instant, shape (n,).
        instants: Times [ns], shape (n,).

    Returns:
        Columns ``row`` (position of the instant), ``atom`` and ``value``.
    """
    groups, own = _codes(episodes, facts["episode_id"])
    time = instants.to_numpy()
    order = np.lexsort((time, groups))
    low = _ranks(groups[order], time[order], own, facts["start_ns"].to_numpy())
    high = _ranks(groups[order], time[order], own, facts["end_ns"].to_numpy())
    fact, position = _expand(low, high)
    return facts[fact].select("atom", "value", row=pl.Series(order[position], dtype=pl.Int64))


def _predominant(facts: pl.DataFrame, rows: pl.DataFrame) -> pl.DataFrame:
    """Atoms that held, or were unknown, for most of each activity; ``rows`` is sorted by track and start.

    Returns:
        Columns ``row``, ``atom`` and ``value``. Time in which an atom was unknown counts for neither side,
        unless it is most of the activity.
    """
    tracks = rows.select(_TRACK).unique()
    own = facts.join(tracks, on="episode_id")
    key = pl.format("{}/{}", "episode_id", "hand").alias("key")
    groups, codes = _codes(rows.select(key)["key"], own.select(key)["key"])
    start, end = rows["start_ns"].to_numpy(), rows["end_ns"].to_numpy()
    order = np.lexsort((start, groups))
    low = _ranks(groups[order], end[order], codes, own["start_ns"].to_numpy())
    high = _ranks(groups[order], start[order], codes, own["end_ns"].to_numpy() - 1)
    fact, position = _expand(low, high)
    place = order[position]
    spans = own[fact].select(
        "atom",
        row=pl.Series(place, dtype=pl.Int64),
        length_ns=pl.Series(end[place] - start[place], dtype=pl.Int64),
        covered_ns=pl.Series(
            np.minimum(own["end_ns"].to_numpy()[fact], end[place])
            - np.maximum(own["start_ns"].to_numpy()[fact], start[place]),
            dtype=pl.Int64,
        ),
        is_true=pl.col("value") == "true",
    )
    return (
        spans.group_by("row", "atom", "length_ns")
        .agg(
            true_ns=pl.col("covered_ns").filter("is_true").sum(),
            unknown_ns=pl.col("covered_ns").filter(~pl.col("is_true")).sum(),
        )
        .with_columns(
            value=pl.when(2 * pl.col("unknown_ns") > pl.col("length_ns"))
            .then(pl.lit("unknown"))
            .when(2 * pl.col("true_ns") > pl.col("length_ns") - pl.col("unknown_ns"))
            .then(pl.lit("true"))
            .cast(facts.schema["value"])
        )
        .drop_nulls("value")
        .select("atom", "value", "row")
    )


def _states(held: pl.DataFrame, n: int) -> pl.DataFrame:
    """Columns ``true`` and ``unknown``, sorted lists of canonical atoms, of rows 0 to n."""
    lists = (
        held.sort("row", "atom")
        .group_by("row", maintain_order=True)
        .agg(
            true=pl.col("atom").filter(pl.col("value") == "true"),
            unknown=pl.col("atom").filter(pl.col("value") == "unknown"),
        )
    )
    return (
        pl.DataFrame({"row": pl.Series(range(n), dtype=pl.Int64)})
        .join(lists, on="row", how="left", maintain_order="left")
        .select(pl.col("true", "unknown").fill_null(pl.lit([], dtype=pl.List(pl.String))))
    )


def _codes(left: pl.Series, right: pl.Series) -> tuple[Ints, Ints]:
    """Codes of two series over the names of both."""
    names = pl.Enum(pl.concat([left, right]).unique().sort())
    first, second = (each.cast(names).to_physical().cast(pl.Int64).to_numpy() for each in (left, right))
    return first, second


def _expand(low: Ints, high: Ints) -> tuple[Ints, Ints]:
    """Every position in the half-open ranges ``[low, high)``, and which range it comes from."""
    count = np.maximum(high - low, 0)
    source = np.repeat(np.arange(len(count)), count)
    return source, np.arange(len(source)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)


def _ranks(groups: Ints, times: Ints, query_groups: Ints, queries: Ints) -> Ints:
    """How many of the sorted (group, time) pairs come before or at each query, all earlier groups included.

    One sort over both, so that the cost stays n log n however long episodes are.
    """
    n = len(times)
    # Times that are equal to a query's come before it.
    is_query = np.concatenate([np.zeros(n, dtype=np.int8), np.ones(len(queries), dtype=np.int8)])
    order = np.lexsort((is_query, np.concatenate([times, queries]), np.concatenate([groups, query_groups])))
    ranks = np.empty(n + len(queries), dtype=np.int64)
    ranks[order] = np.cumsum(is_query[order] == 0)
    return ranks[n:]
