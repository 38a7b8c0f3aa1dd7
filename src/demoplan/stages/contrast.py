"""Activities and facts to transitions: what each activity changed."""

from collections.abc import Mapping

import dataframely as dy
import numpy as np
import polars as pl
from numpy.typing import NDArray

from demoplan.errors import DataError, UnknownNameError
from demoplan.tables import Activities, Facts, Transitions

_EPISODE_HAND = ["episode_id", "hand"]


def contrast(
    activities: dy.DataFrame[Activities], facts: dy.DataFrame[Facts], entities: Mapping[str, str]
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

    Returns:
        One row per activity, sorted by episode, hand and start.

    Raises:
        UnknownNameError: If an activity or a fact names an instance that ``entities`` does not have.
        DataError: If a hand's activities overlap.
    """
    _require_known(activities, facts, entities)
    if activities.is_empty():
        return Transitions.create_empty()
    rows = activities.sort([*_EPISODE_HAND, "start_ns"]).with_columns(
        previous_activity=pl.col("activity").shift().over(_EPISODE_HAND),
        previous_end_ns=pl.col("end_ns").shift().over(_EPISODE_HAND),
    )
    overlapping = rows.filter(pl.col("previous_end_ns") > pl.col("start_ns"))
    if not overlapping.is_empty():
        first = overlapping.row(0, named=True)
        raise DataError(
            f"activities of hand {first['hand']!r} in episode {first['episode_id']!r} overlap: one starts at "
            f"{first['start_ns']} ns, before the previous one ends at {first['previous_end_ns']} ns"
        )
    # The instant before the first tick's end is the first tick itself: left limits need one nanosecond more.
    instants = rows.select(
        "episode_id", before=pl.col("previous_end_ns").fill_null(pl.col("start_ns") + 1), after="end_ns"
    )
    states = {side: _states(facts, instants["episode_id"], instants[side]) for side in ("before", "after")}
    objects = [{"name": name, "type": entities[name]} for name in sorted(entities)]
    field = Transitions.create_empty().schema["objects"]
    table = rows.select(
        *_EPISODE_HAND,
        "start_ns",
        "end_ns",
        "activity",
        "previous_activity",
        pl.lit(None, dtype=pl.List(pl.String)).alias("arguments"),
        "acted_on",
        "in_hand",
        pl.lit(pl.Series([objects], dtype=field)).first().alias("objects"),
        states["before"]["true"].alias("before"),
        states["after"]["true"].alias("after"),
        states["before"]["unknown"].alias("unknown_before"),
        states["after"]["unknown"].alias("unknown_after"),
    )
    return Transitions.validate(table)


def _require_known(
    activities: dy.DataFrame[Activities], facts: dy.DataFrame[Facts], entities: Mapping[str, str]
) -> None:
    named = pl.concat(
        [activities[column] for column in ("hand", "acted_on", "in_hand")] + [facts["arguments"].explode()]
    )
    for name in named.drop_nulls().unique().sort():
        if name not in entities:
            raise UnknownNameError("instance", name, entities, "the mapping's entities")


def _states(facts: dy.DataFrame[Facts], episodes: pl.Series, instants: pl.Series) -> pl.DataFrame:
    """Sorted atoms that were true, and unknown, in the left limit of each instant.

    Args:
        facts: Intervals ``[start, end)``; one holds in the left limit of ``t`` when ``start < t <= end``.
        episodes: Episode of each instant, shape (n,).
        instants: Times [ns], shape (n,).

    Returns:
        Columns ``true`` and ``unknown``, lists of canonical atoms, shape (n,).
    """
    n = len(instants)
    codes = pl.Enum(pl.concat([episodes, facts["episode_id"]]).unique().sort())
    episode = episodes.cast(codes).to_physical().to_numpy().astype(np.int64)
    time = instants.to_numpy()
    order = np.lexsort((time, episode))
    low, high = _ranks(
        (episode[order], time[order]),
        facts["episode_id"].cast(codes).to_physical().to_numpy().astype(np.int64),
        facts["start_ns"].to_numpy(),
        facts["end_ns"].to_numpy(),
    )
    count = np.maximum(high - low, 0)
    fact = np.repeat(np.arange(facts.height), count)
    position = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count) + np.repeat(low, count)
    atoms = facts.select(
        pl.format("{}({})", "predicate", pl.col("arguments").list.join(",")).alias("atom"), "value"
    )
    held = atoms[fact].with_columns(pl.Series("instant", order[position]))
    lists = (
        held.sort("instant", "atom")
        .group_by("instant", maintain_order=True)
        .agg(
            true=pl.col("atom").filter(pl.col("value") == "true"),
            unknown=pl.col("atom").filter(pl.col("value") == "unknown"),
        )
    )
    empty = pl.lit([], dtype=pl.List(pl.String))
    return (
        pl.DataFrame({"instant": np.arange(n)})
        .join(lists, on="instant", how="left", maintain_order="left")
        .select(pl.col("true", "unknown").fill_null(empty))
    )


def _ranks(
    instants: tuple[NDArray[np.int64], NDArray[np.int64]],
    episode: NDArray[np.int64],
    start_ns: NDArray[np.int64],
    end_ns: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each interval, the first and the past-last of the sorted instants with ``start < t <= end``.

    Ranks come from one sort over (episode, time), so that the cost stays n log n however long episodes are.
    """
    at_episode, at_time = instants
    n = len(at_time)

    def rank(times: NDArray[np.int64]) -> NDArray[np.int64]:
        # Instants that are <= a query's time come before it, those of later episodes after it.
        is_query = np.r_[np.zeros(n, dtype=np.int8), np.ones(len(times), dtype=np.int8)]
        order = np.lexsort((is_query, np.r_[at_time, times], np.r_[at_episode, episode]))
        before = np.cumsum(is_query[order] == 0)
        ranks = np.empty(n + len(times), dtype=np.int64)
        ranks[order] = before
        return ranks[n:]

    return rank(start_ns), rank(end_ns)
