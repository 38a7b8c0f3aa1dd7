"""What happened when a plan was run: one row per dispatched step, and one per run."""

import dataframely as dy

STEP_STATES = ("not_executed", "executing", "succeeded", "skipped", "failed", "cancelled", "timeout")
FAILURE_CLASSES = ("perception", "motion", "execution_offset", "operator_model", "exogenous")


class Executions(dy.Schema):
    """One row per step of a run, in order of dispatch; replanned steps follow with a higher ``plan_index``.

    Times are simulated time from the start of the run.
    """

    run_id = dy.String(primary_key=True, description="Hash of domain, goal, robot, faults and seed")
    plan_index = dy.Int64(primary_key=True, min=0, description="Which plan of the run: 0, then each replan")
    step_index = dy.Int64(primary_key=True, min=0, description="Which step of that plan")
    operator = dy.String(description="Operator of the step")
    arguments = dy.List(dy.String(), description="Instances, in order of the operator's parameters")
    hand = dy.String(nullable=True, description="Hand that moves, if the step has one")
    activity = dy.String(description="Activity that names the motion")
    state = dy.Enum(STEP_STATES, description="How the step ended")
    start_ns = dy.Int64(nullable=True, description="When it was dispatched", metadata={"unit": "ns"})
    end_ns = dy.Int64(nullable=True, description="When it ended", metadata={"unit": "ns"})
    unmet = dy.List(dy.String(), description="Preconditions that were not sensed at dispatch")
    missing = dy.List(dy.String(), description="Expected effects that were not sensed after it")
    extra = dy.List(dy.String(), description="Sensed changes that no running step expects")
    failure = dy.Enum(FAILURE_CLASSES, nullable=True, description="Class that the monitor gave it")
    cause = dy.String(nullable=True, description="In words, with figures")
    tracking_error_m = dy.Float64(
        nullable=True,
        min=0.0,
        description="Largest distance between commanded and reached hand position",
        metadata={"unit": "m"},
    )
    peak_force_n = dy.Float64(
        nullable=True, min=0.0, description="Largest contact force on the hand", metadata={"unit": "N"}
    )
    n_collisions = dy.Int64(nullable=True, min=0, description="Unwanted contacts begun during the step")


class Runs(dy.Schema):
    """One row per run: a domain, a goal, a robot, a seed, and what became of it."""

    run_id = dy.String(primary_key=True, description="Hash of domain, goal, robot, faults and seed")
    domain_id = dy.String(description="Domain that was planned with")
    domain_name = dy.String(description="What the domain was learned from")
    goal = dy.String(description="Goal's name or text")
    robot = dy.String(description="gripper, tiago, …")
    monitor = dy.Enum(["full", "preconditions", "none"], description="What was checked while it ran")
    seed = dy.Int64(min=0, description="Seed of scene, sensing and faults")
    fault = dy.String(nullable=True, description="Name of the fault that was to be injected, if any")
    fault_kind = dy.String(nullable=True, description="What kind of fault: placing_offset, slip, …")
    fault_class = dy.Enum(FAILURE_CLASSES, nullable=True, description="Its true class")
    severity = dy.String(nullable=True, description="As the faults file calls it: mild, moderate, severe")
    is_fault_injected = dy.Bool(description="Whether the run came to the point at which it happens")
    fault_ns = dy.Int64(
        nullable=True,
        description="When it happened; a wrong operator, from the start",
        metadata={"unit": "ns"},
    )
    is_recoverable = dy.Bool(
        nullable=True,
        description="Whether the goal could be reached after the fault: see FaultCases; null if none happens",
    )
    is_goal_reached = dy.Bool(description="By physics, at the end")
    is_goal_sensed = dy.Bool(description="As the monitor believes")
    outcome = dy.Enum(
        ["reached", "no_plan", "out_of_reach", "gave_up", "timeout", "planner_failed", "not_started"],
        description="How the run ended, as the executor believes",
    )
    reason = dy.String(nullable=True, description="Why, in words")
    n_plans = dy.Int64(min=0, description="Plans made: one, and each replan")
    n_steps = dy.Int64(min=0, description="Steps dispatched")
    n_discrepancies = dy.Int64(min=0, description="Discrepancies that were acted upon")
    n_passed = dy.Int64(min=0, description="Discrepancies that were gone at the second look")
    n_false_alarms = dy.Int64(
        min=0, description="Of those acted upon, the ones without a true discrepancy behind them"
    )
    n_unsound = dy.Int64(
        min=0, description="Steps dispatched although a condition that lasts was physically false"
    )
    diagnosed = dy.Enum(
        FAILURE_CLASSES,
        nullable=True,
        description="Class first named after the fault, or in a run without one at all",
    )
    simulated_s = dy.Float64(min=0.0, description="Simulated time", metadata={"unit": "s"})


class FaultCases(dy.Schema):
    """One row per fault in a domain, goal, robot and seed: whether anybody could recover from it.

    It is decided without any monitor, by what is physically so after the fault; so every monitor is held
    against the same cases.
    """

    case_id = dy.String(primary_key=True, description="Hash of domain, goal, robot, fault and seed")
    has_happened = dy.Bool(description="Whether the fault happens when the plan is carried out open loop")
    is_recoverable = dy.Bool(
        nullable=True,
        description="Whether a plan leads from the true state to the goal; null without a fault",
    )
    reason = dy.String(description="Why, in words")
