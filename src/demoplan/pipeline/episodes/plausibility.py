"""What was read of a log, held against what a mapping promises: an error now, instead of silence later."""

from collections.abc import Iterable
from dataclasses import dataclass

import dataframely as dy
import numpy as np
import polars as pl

from demoplan.errors import DataError
from demoplan.manifests.mapping import Mapping
from demoplan.tables import Samples, Topics


@dataclass(frozen=True, kw_only=True)
class PlausibilityParams:
    """From where on a log cannot mean what its mapping says."""

    reach_m: float = 20.0
    """No hand and no object of a manipulation is farther from its reference frame than this [m]."""
    least_extent_m: float = 0.002
    """A tracked body that never leaves its reference frame's origin by more was not tracked in metres [m]."""


def refuse_implausible(
    samples: dy.DataFrame[Samples],
    topics: dy.DataFrame[Topics],
    mapping: Mapping,
    params: PlausibilityParams = PlausibilityParams(),
) -> None:
    """Raise if a required topic gave nothing, or positions cannot be in the unit that the mapping states.

    Args:
        samples: What was read; positions are in metres if the mapping's units are right.
        topics: How much was read of each topic.
        mapping: What was expected.
        params: Limits.

    Raises:
        DataError: If so; it says which topic, what was found, and what to change.
    """
    refuse_empty(topics, mapping)
    if not are_within(samples, params):
        refuse_units([samples], mapping, params)


def refuse_empty(topics: dy.DataFrame[Topics], mapping: Mapping) -> None:
    """Raise if a required topic gave nothing.

    Raises:
        DataError: If so.
    """
    required = {label.split("#")[0] for label, topic in mapping.topics.items() if topic.required}
    silent = topics.filter(
        pl.col("topic").is_in(sorted(required)) & (pl.col("n_messages") > 0) & (pl.col("n_rows") == 0)
    )
    for row in silent.iter_rows(named=True):
        raise DataError(
            f"topic {row['topic']} ({row['message_type']}): none of {row['n_messages']} messages gave "
            f"a usable reading: {row['note'] or 'no reason is known'}; "
            "mend the mapping, or say `required: false`"
        )


def refuse_units(
    parts: Iterable[dy.DataFrame[Samples]],
    mapping: Mapping,
    params: PlausibilityParams = PlausibilityParams(),
) -> None:
    """Raise if the positions of a body cannot be in the unit that the mapping states.

    Args:
        parts: The samples, some rows at a time.
        mapping: What was expected.
        params: Limits.

    Raises:
        DataError: If so.
    """
    entities = set(mapping.entities)
    body = ("topic", "entity", "kind")
    furthest = pl.concat(
        part.filter(pl.col("is_tracked") & pl.col("position_xyz_m").is_not_null() & ~pl.col("is_static"))
        .group_by(body, maintain_order=True)
        .agg(pl.col("position_xyz_m").arr.eval(pl.element().abs()).arr.max().max().alias("far"))
        for part in parts
    )
    of_bodies = furthest.group_by(body, maintain_order=True).agg(pl.col("far").max())
    for row in of_bodies.iter_rows(named=True):
        if row["kind"] == "transform" and row["entity"] not in entities:
            continue
        if row["far"] > params.reach_m:
            unit = "mm" if row["far"] > 20 * params.reach_m else "cm"
            raise DataError(
                f"topic {row['topic']}: {row['entity']} is up to {row['far']:.4g} m away, farther than "
                f"anything that is manipulated ({params.reach_m:g} m): the positions seem to be in {unit}; "
                f"map the topic with `unit: {unit}`"
            )
        if row["kind"] == "pose" and row["far"] < params.least_extent_m:
            raise DataError(
                f"topic {row['topic']}: {row['entity']} is never more than {row['far']:.3g} m from its "
                "reference frame's origin: check the topic's `unit`"
            )


def are_within(samples: dy.DataFrame[Samples], params: PlausibilityParams = PlausibilityParams()) -> bool:
    """Whether no reading is too far away, and no pose too near the origin: then no body is, either.

    This takes a fraction of looking at each body by itself.
    """
    if not len(samples):
        return True
    position = np.abs(samples["position_xyz_m"].to_numpy())
    # Coordinate by coordinate, since rows of three are slow to reduce; not a number is neither far nor near.
    if np.fmax.reduce(position, axis=None) > params.reach_m:
        return False
    near = np.flatnonzero(position[:, 0] < params.least_extent_m)
    near = near[(position[near] < params.least_extent_m).all(axis=1)]
    kinds = samples["kind"].gather(near)
    return not (samples["is_tracked"].gather(near) & (kinds == "pose")).any()
