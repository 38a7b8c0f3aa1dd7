"""What a log said, as it said it: one row per message field group of one entity."""

import dataframely as dy
import polars as pl


class Samples(dy.Schema):
    """One row per message field group of one entity, in file order; nothing is resampled or corrected.

    A field group is a pose, a grip reading or a transform. Several bodies in one message give several rows.
    """

    episode_id = dy.String(description="The demonstration that the log belongs to")
    topic = dy.String(description="Topic, or topic#field path where one topic carries several groups")
    entity = dy.String(description="Mapped entity; for a transform, the child frame")
    kind = dy.Enum(["pose", "grip", "transform"], description="Which field group the row holds")
    reference = dy.String(description="Frame in which the pose is given; for a transform, the parent frame")
    is_static = dy.Bool(description="A latched transform that holds for the whole episode")
    message_index = dy.Int64(min=0, description="Which message of its topic, in file order")
    stamp_ns = dy.Int64(
        description="Time on the clock that the mapping chose for the topic", metadata={"unit": "ns"}
    )
    log_ns = dy.Int64(description="When the recorder received the message", metadata={"unit": "ns"})
    publish_ns = dy.Int64(
        nullable=True, description="When it was published, if the log has it", metadata={"unit": "ns"}
    )
    header_ns = dy.Int64(
        nullable=True, description="When it was measured, if it has a header", metadata={"unit": "ns"}
    )
    position_xyz_m = dy.Array(
        dy.Float64(nullable=True),
        3,
        nullable=True,
        description="Position in reference",
        metadata={"unit": "m"},
    )
    orientation_wxyz = dy.Array(
        dy.Float64(nullable=True),
        4,
        nullable=True,
        description="Orientation in reference, as recorded (not normalised)",
    )
    grip = dy.Float64(nullable=True, description="Opening of the hand: 0 closed, 1 open")
    is_tracked = dy.Bool(description="The reading is finite, and its source says that it is valid")

    @dy.rule()
    def group_matches_kind(cls) -> pl.Expr:  # noqa: N805
        """A grip row has a grip, any other row a position."""
        return (pl.col("kind") == "grip") == pl.col("position_xyz_m").is_null()
