"""What an activity changed: one row per activity, with the atoms before and after it."""

import dataframely as dy
import polars as pl


class Transitions(dy.Schema):
    """The transition *into* each activity.

    ``before`` is the state at the end of the hand's previous segment, ``after`` at the end of this one.
    Atoms are canonical text, ``inHand(Right_hand,Cube_green1)``; a state lists what was true, and what
    could not be observed; all else was observed false.
    """

    episode_id = dy.String(primary_key=True, description="The demonstration")
    hand = dy.String(primary_key=True, description="Hand instance; for a symbolic trace, the empty name")
    start_ns = dy.Int64(primary_key=True, description="When the activity begins", metadata={"unit": "ns"})
    end_ns = dy.Int64(description="When it ends", metadata={"unit": "ns"})
    activity = dy.String(description="Name of the activity")
    previous_activity = dy.String(nullable=True, description="The hand's activity before it")
    arguments = dy.List(
        dy.String(), nullable=True, description="Instances named by a symbolic trace's action; null for logs"
    )
    acted_on = dy.String(nullable=True, description="Object instance that the hand acts on")
    in_hand = dy.String(nullable=True, description="Object instance that the hand holds")
    objects = dy.List(
        dy.Struct({"name": dy.String(), "type": dy.String()}),
        description="Every instance of the episode with its type, sorted by name",
    )
    before = dy.List(dy.String(), description="Atoms true before, sorted")
    after = dy.List(dy.String(), description="Atoms true after, sorted")
    unknown_before = dy.List(dy.String(), description="Atoms not observed before, sorted")
    unknown_after = dy.List(dy.String(), description="Atoms not observed after, sorted")

    @dy.rule()
    def interval_is_not_empty(cls) -> pl.Expr:  # noqa: N805
        """Intervals are half-open and last at least one tick."""
        return pl.col("start_ns") < pl.col("end_ns")
