"""What the planner answered: one row per attempt, outcome always present."""

import dataframely as dy


class Plans(dy.Schema):
    """One row per planning attempt."""

    domain_id = dy.String(primary_key=True, description="Domain that was planned with")
    problem_id = dy.String(primary_key=True, description="Hash of the problem's canonical text")
    attempt = dy.Int64(primary_key=True, min=0, description="Attempt of a widening ladder, from 0")
    goal = dy.String(description="Goal, as canonical text")
    outcome = dy.Enum(
        [
            "solved",
            "unsolvable",
            "gave_up",
            "out_of_time",
            "out_of_memory",
            "bad_input",
            "invalid_plan",
            "planner_missing",
            "failed",
        ],
        description="How the attempt ended",
    )
    is_explained = dy.Bool(description="Whether the exit code explains the outcome")
    is_validated = dy.Bool(description="The plan was simulated independently and reaches the goal")
    n_operators = dy.Int64(min=0, description="Operators that the attempt could use")
    n_steps = dy.Int64(nullable=True, min=0, description="Length of the plan")
    cost = dy.Int64(nullable=True, min=0, description="Cost of the plan")
    steps = dy.List(dy.String(), nullable=True, description="Steps: operator(instance,…), in order")
    message = dy.String(nullable=True, description="What the planner said, or what is missing")
