"""What held when: one row per longest interval on which one ground atom held, or could not be known."""

import dataframely as dy
import polars as pl


class Facts(dy.Schema):
    """Longest intervals of ground atoms. What is not listed was observed false.

    ``value`` is ``true`` where the atom held and ``unknown`` where it could not be observed, so that
    missing data is never silently false. Intervals of one atom never overlap.
    """

    episode_id = dy.String(primary_key=True, description="The demonstration")
    predicate = dy.String(primary_key=True, description="Predicate of the vocabulary")
    arguments = dy.List(dy.String(), primary_key=True, description="Instances, in the predicate's order")
    start_ns = dy.Int64(primary_key=True, description="First tick", metadata={"unit": "ns"})
    end_ns = dy.Int64(description="First tick after it", metadata={"unit": "ns"})
    value = dy.Enum(["true", "unknown"], description="Held, or could not be observed")

    @dy.rule()
    def interval_is_not_empty(cls) -> pl.Expr:  # noqa: N805
        """Intervals are half-open and last at least one tick."""
        return pl.col("start_ns") < pl.col("end_ns")
