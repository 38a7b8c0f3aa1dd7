"""Who did what when: one row per stretch of one hand doing one thing."""

import dataframely as dy
import polars as pl


class Activities(dy.Schema):
    """Activities of each hand, which tile its episode in order, without gap or overlap.

    True labels have the same form: what was inferred and what is true are different tables of one schema.
    """

    episode_id = dy.String(primary_key=True, description="The demonstration")
    hand = dy.String(primary_key=True, description="Hand instance")
    start_ns = dy.Int64(primary_key=True, description="First tick", metadata={"unit": "ns"})
    end_ns = dy.Int64(description="First tick after it", metadata={"unit": "ns"})
    activity = dy.String(description="Name of the activity: Idle, Reach, Take, Put, Release, …")
    acted_on = dy.String(nullable=True, description="Object instance that the hand approaches or acts on")
    in_hand = dy.String(nullable=True, description="Object instance that the hand holds")

    @dy.rule()
    def interval_is_not_empty(cls) -> pl.Expr:  # noqa: N805
        """Intervals are half-open and last at least one tick."""
        return pl.col("start_ns") < pl.col("end_ns")
