"""What was read: one row per episode, and one per topic of it."""

import dataframely as dy


class Episodes(dy.Schema):
    """One row per episode of a dataset, whatever became of it."""

    episode_id = dy.String(primary_key=True, description="The demonstration")
    dataset = dy.String(description="Dataset that it belongs to")
    file = dy.String(description="Log, relative to the dataset's root")
    sha256 = dy.String(nullable=True, description="Hash of the log's bytes; null if it could not be read")
    participant = dy.String(description="Who demonstrates")
    task = dy.String(description="What was to be done")
    is_goal_reached = dy.Bool(nullable=True, description="Whether the demonstration reached its goal")
    status = dy.Enum(["complete", "truncated", "quarantined"], description="What became of it")
    reason = dy.String(nullable=True, description="Why it is truncated or quarantined")
    start_ns = dy.Int64(nullable=True, description="First stamp", metadata={"unit": "ns"})
    end_ns = dy.Int64(nullable=True, description="Last stamp", metadata={"unit": "ns"})


class Topics(dy.Schema):
    """One row per topic of a log: nothing is dropped in silence."""

    episode_id = dy.String(primary_key=True, description="The demonstration")
    topic = dy.String(primary_key=True, description="Topic name")
    message_type = dy.String(description="Type name as the log states it")
    encoding = dy.String(description="Message encoding: cdr, ros1, protobuf, json")
    is_mapped = dy.Bool(description="The mapping reads it")
    n_messages = dy.Int64(min=0, description="Messages in the log")
    n_rows = dy.Int64(min=0, description="Rows that came of them")
    n_rejected = dy.Int64(min=0, description="Messages that did not decode or held no usable value")
    note = dy.String(nullable=True, description="What was wrong with rejected messages")
