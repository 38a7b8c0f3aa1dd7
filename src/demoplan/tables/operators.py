"""What was learned: operators, their literals, and the evidence behind each literal."""

import dataframely as dy
import polars as pl


class Operators(dy.Schema):
    """One row per operator."""

    operator = dy.String(primary_key=True, description="Name, unique in its domain: the activity, numbered")
    activity = dy.String(description="Activity that the operator leads into")
    parameters = dy.List(
        dy.Struct({"variable": dy.String(), "type": dy.String()}), description="Typed variables, in order"
    )
    n_transitions = dy.Int64(min=0, description="Transitions that it explains: the paper's count")
    n_episodes = dy.Int64(min=0, description="Episodes that they come from")
    n_successes = dy.Int64(min=0, description="Executions whose effects were sensed")
    n_failures = dy.Int64(min=0, description="Executions whose effects were not sensed")
    beta = dy.Float64(min=0.0, max=1.0, description="Posterior mean probability of success")
    cost = dy.Int64(min=0, description="Planner's cost: more often shown or more reliable is cheaper")
    is_quarantined = dy.Bool(description="Left out of the domain, with its reason in `note`")
    note = dy.String(nullable=True, description="Why it is quarantined, or stands apart from a sibling")


class Literals(dy.Schema):
    """One row per literal that was considered for an operator, kept or not."""

    operator = dy.String(primary_key=True, description="Operator that it belongs to")
    role = dy.Enum(["precondition", "effect"], primary_key=True, description="Where it stands")
    predicate = dy.String(primary_key=True, description="Predicate of the vocabulary")
    variables = dy.List(dy.String(), primary_key=True, description="Variables, in the predicate's order")
    is_positive = dy.Bool(primary_key=True, description="False for a negated literal")
    n_support = dy.Int64(min=0, description="Transitions in which it was observed so")
    n_against = dy.Int64(min=0, description="Transitions in which the opposite was observed")
    n_transitions = dy.Int64(min=0, description="Transitions of the operator")
    probability = dy.Float64(min=0.0, max=1.0, description="Posterior probability that it belongs")
    is_kept = dy.Bool(description="Stated in the domain")
    note = dy.String(nullable=True, description="Why it was dropped or kept against the count")

    @dy.rule()
    def counts_fit(cls) -> pl.Expr:  # noqa: N805
        """Support and counter-support never exceed the transitions."""
        return pl.col("n_support") + pl.col("n_against") <= pl.col("n_transitions")


class Evidence(dy.Schema):
    """One row per operator and transition behind it: where each literal can be looked up in a recording."""

    operator = dy.String(primary_key=True, description="Operator that it supports")
    episode_id = dy.String(primary_key=True, description="The demonstration")
    hand = dy.String(primary_key=True, description="Hand instance")
    start_ns = dy.Int64(primary_key=True, description="When the activity begins", metadata={"unit": "ns"})
    end_ns = dy.Int64(description="When it ends", metadata={"unit": "ns"})
    binding = dy.List(dy.String(), description="Instances bound to the operator's parameters, in order")
    contradicts = dy.List(dy.String(), description="Stated literals that this transition did not show")
