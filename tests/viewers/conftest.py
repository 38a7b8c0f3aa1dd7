"""Made-up but plausible tables: two hands stack four cubes for half a minute, at 100 Hz.

Nothing here is measured: it exists so that views can be tested without a log, a stage or a simulator.
"""

from dataclasses import dataclass

import numpy as np
import polars as pl
import pytest

from demoplan import tables
from demoplan.language.vocabulary import Shape
from demoplan.viewers.report import Confusion, DomainText, Failure, Reference, ReportContent

TICK_NS = 10_000_000
START_NS = 1_790_000_000_000_000_000
EDGE_M = 0.05
EPISODE = "p1-two-both"
CUBES = ("cube_blue", "cube_green", "cube_red", "cube_yellow")
HANDS = ("Left_hand", "Right_hand")
PHASES = (("Reach", 1.2), ("Take", 0.6), ("Put", 1.6), ("Release", 0.9))


@dataclass(frozen=True)
class Move:
    """One cube carried by one hand."""

    hand: str
    cube: str
    start_s: float
    target: tuple[float, float, float]
    support: str


MOVES = (
    Move("Right_hand", "cube_red", 2.0, (0.05, 0.00, 0.075), "cube_blue"),
    Move("Left_hand", "cube_yellow", 9.0, (-0.20, 0.12, 0.075), "cube_green"),
    Move("Right_hand", "cube_red", 15.0, (0.22, -0.10, 0.025), "table"),
    Move("Left_hand", "cube_yellow", 17.0, (0.05, 0.00, 0.075), "cube_blue"),
    Move("Right_hand", "cube_red", 23.0, (0.05, 0.00, 0.125), "cube_yellow"),
)
RESTING = {
    "cube_blue": (0.05, 0.0, 0.025),
    "cube_green": (-0.20, 0.12, 0.025),
    "cube_red": (0.25, 0.15, 0.025),
    "cube_yellow": (-0.25, -0.12, 0.025),
}
HOME = {"Left_hand": (-0.35, -0.30, 0.20), "Right_hand": (0.35, -0.30, 0.20)}


def _ease(start, end, n):
    s = np.linspace(0.0, 1.0, n)[:, None]
    bow = np.array([0.0, 0.0, 0.08]) * np.sin(np.pi * s)
    return start + (end - start) * (10 * s**3 - 15 * s**4 + 6 * s**5) + bow


def _paths(n_ticks):
    where = {c: np.tile(np.array(p), (n_ticks, 1)) for c, p in RESTING.items()}
    hands = {h: np.tile(np.array(p), (n_ticks, 1)) for h, p in HOME.items()}
    grip = {h: np.ones(n_ticks) for h in HANDS}
    activities = {h: [] for h in HANDS}
    for move in MOVES:
        k = round(move.start_s * 100)
        spans = []
        for _, seconds in PHASES:
            spans.append((k, k + round(seconds * 100)))
            k = spans[-1][1]
        home = np.array(HOME[move.hand])
        pick = where[move.cube][spans[0][0]] + [0, 0, 0.03]
        drop = np.add(move.target, (0, 0, 0.03))
        for (a, b), (start, end) in zip(
            spans, ((home, pick), (pick, pick), (pick, drop), (drop, home)), strict=True
        ):
            hands[move.hand][a:b] = _ease(start, end, b - a) if not np.allclose(start, end) else start
        take, put, release = spans[1], spans[2], spans[3]
        grip[move.hand][take[0] : take[1]] = np.linspace(1.0, 0.1, take[1] - take[0])
        grip[move.hand][put[0] : put[1]] = 0.1
        grip[move.hand][release[0] : release[0] + 30] = np.linspace(0.1, 1.0, 30)
        where[move.cube][put[0] : put[1]] = hands[move.hand][put[0] : put[1]] - [0, 0, 0.03]
        where[move.cube][put[1] :] = move.target
        activities[move.hand] += [
            (name, a, b, move.cube, move.cube if name == "Put" else None)
            for (name, _), (a, b) in zip(PHASES, spans, strict=True)
        ]
    return where, hands, grip, activities


def synthetic_frames(seconds=30.0):
    """Frames with a gap in one cube's and one hand's track, and slow tremor."""
    n = round(seconds * 100)
    where, hands, grip, _ = _paths(n)
    ticks = START_NS + TICK_NS * np.arange(n)
    rng = np.random.default_rng(7)
    parts = []
    for entity, path in sorted({**where, **hands, "table": np.tile([0.0, 0.0, -0.02], (n, 1))}.items()):
        noise = rng.normal(0, 0.0004, path.shape) if entity != "table" else 0.0
        gap = np.zeros(n, bool)
        if entity == "cube_green":
            gap[1000:1250] = True
        if entity == "Left_hand":
            gap[400:460] = True
        position = [None if g else list(p) for g, p in zip(gap, path + noise, strict=True)]
        parts.append(
            pl.DataFrame(
                {
                    "episode_id": [EPISODE] * n,
                    "entity": [entity] * n,
                    "tick_ns": ticks,
                    "position_xyz_m": pl.Series(position, dtype=pl.Array(pl.Float64, 3)),
                    "orientation_wxyz": pl.Series(
                        [None if g else [1.0, 0.0, 0.0, 0.0] for g in gap], dtype=pl.Array(pl.Float64, 4)
                    ),
                    "grip": pl.Series(grip[entity] if entity in grip else [None] * n, dtype=pl.Float64),
                    "pose_age_ns": pl.Series([None if g else 0 for g in gap], dtype=pl.Int64),
                }
            )
        )
    return tables.Frames.validate(pl.concat(parts), cast=True)


def synthetic_activities(shift_ticks=0, episode_id=EPISODE, seconds=30.0):
    """Activities that tile the episode per hand; a shift moves the inner boundaries, as a classifier errs."""
    n = round(seconds * 100)
    *_, activities = _paths(n)
    rows = []
    for hand, spans in activities.items():
        cursor, filled = 0, []
        for name, a, b, cube, held in sorted(spans, key=lambda s: s[1]):
            if a > cursor:
                filled.append(("Idle", cursor, a, None, None))
            filled.append((name, a, b, cube, held))
            cursor = b
        filled.append(("Idle", cursor, n, None, None))
        for name, a, b, cube, held in filled:
            a2 = a if a == 0 else a + shift_ticks
            b2 = b if b == n else b + shift_ticks
            rows.append(
                (episode_id, hand, START_NS + a2 * TICK_NS, START_NS + b2 * TICK_NS, name, cube, held)
            )
    frame = pl.DataFrame(
        rows,
        schema={
            "episode_id": pl.String,
            "hand": pl.String,
            "start_ns": pl.Int64,
            "end_ns": pl.Int64,
            "activity": pl.String,
            "acted_on": pl.String,
            "in_hand": pl.String,
        },
        orient="row",
    )
    return tables.Activities.validate(frame.sort("episode_id", "hand", "start_ns"))


def synthetic_facts(seconds=30.0):
    """Facts that fit the moves, and stretches that could not be observed."""
    n = round(seconds * 100)
    *_, activities = _paths(n)
    rows = []

    def add(predicate, arguments, a, b, value="true"):
        if b > a:
            rows.append(
                (EPISODE, predicate, list(arguments), START_NS + a * TICK_NS, START_NS + b * TICK_NS, value)
            )

    support = dict.fromkeys(CUBES, ("table", 0))
    covered = {}
    for hand in HANDS:
        cursor = 0
        for name, a, b, cube, _ in sorted(activities[hand], key=lambda s: s[1]):
            if name in ("Reach", "Put", "Release"):
                add("handMove", [hand], a, b)
            if name == "Reach":
                add("handOpen", [hand], cursor, b + 25)
                add("actedOn", [hand, cube], a + 20, b)
                add("graspable", [hand, cube], b - 15, b + 20)
            if name == "Put":
                add("inHand", [hand, cube], a - 20, b + 5)
                add("inTouch", [cube, hand], a - 25, b + 10)
                cursor = b + 10
        add("handOpen", [hand], cursor, n)
    for move in MOVES:
        lift = round(move.start_s * 100) + 180
        drop = lift + 160
        under, since = support[move.cube]
        add("onTop", [move.cube, under], since, lift + 5)
        add("inTouch", [move.cube, under], since, lift)
        if under != "table":
            covered.setdefault(under, []).append((since, lift + 5))
        support[move.cube] = (move.support, drop)
    for cube, (under, since) in support.items():
        if cube == "cube_green":
            add("onTop", [cube, under], since, 1000)
            add("onTop", [cube, under], 1000, 1250, "unknown")
            add("onTop", [cube, under], 1250, n)
        else:
            add("onTop", [cube, under], since, n)
        add("inTouch", [cube, under], since, n)
        if under != "table":
            covered.setdefault(under, []).append((since, n))
    for cube in CUBES:
        cursor = 0
        for a, b in sorted(covered.get(cube, [])):
            add("clear", [cube], cursor, a)
            cursor = b
        add("clear", [cube], cursor, n)
    frame = pl.DataFrame(
        rows,
        schema={
            "episode_id": pl.String,
            "predicate": pl.String,
            "arguments": pl.List(pl.String),
            "start_ns": pl.Int64,
            "end_ns": pl.Int64,
            "value": pl.String,
        },
        orient="row",
    )
    return tables.Facts.validate(frame.sort("predicate", "arguments", "start_ns"), cast=True)


def synthetic_evidence():
    """One row per activity that some operator explains."""
    rows = [
        (
            f"{r['activity'].lower()}_1",
            r["episode_id"],
            r["hand"],
            r["start_ns"],
            r["end_ns"],
            [r["hand"], r["acted_on"] or "table"],
            ["graspable(?h,?c)"]
            if r["activity"] == "Reach" and r["start_ns"] > START_NS + 2 * 10**10
            else [],
        )
        for r in synthetic_activities().to_dicts()
        if r["activity"] != "Idle"
    ]
    frame = pl.DataFrame(
        rows,
        schema={
            "operator": pl.String,
            "episode_id": pl.String,
            "hand": pl.String,
            "start_ns": pl.Int64,
            "end_ns": pl.Int64,
            "binding": pl.List(pl.String),
            "contradicts": pl.List(pl.String),
        },
        orient="row",
    )
    return tables.Evidence.validate(frame.sort("operator", "episode_id", "hand", "start_ns"))


def synthetic_entities():
    """What the scene looks like: (name, type, shape)."""
    cube = Shape("box", (EDGE_M, EDGE_M, EDGE_M))
    return {
        **dict.fromkeys(CUBES, ("WoodenCube", cube)),
        "table": ("Table", Shape("box", (1.2, 0.8, 0.04))),
        **{hand: ("Hand", Shape("point", (0.0, 0.0, 0.0))) for hand in HANDS},
    }


def synthetic_episodes(n_more=2):
    """The episode itself, some that went well, one truncated, one quarantined."""
    common = {"dataset": "cube-stacking", "participant": "p1", "task": "stack two cubes on one another"}
    rows = [
        {"episode_id": EPISODE, "status": "complete", "reason": None, "is_goal_reached": True},
        *(
            {"episode_id": f"p2-one-{k}", "status": "complete", "reason": None, "is_goal_reached": k % 2 == 0}
            for k in range(n_more)
        ),
        {
            "episode_id": "p3-cut",
            "status": "truncated",
            "reason": "the log ends within a chunk; 1933 of 2000 messages kept",
            "is_goal_reached": None,
        },
        {
            "episode_id": "p3-bad",
            "status": "quarantined",
            "reason": "not a log: magic bytes are 'PK', expected MCAP, ROS bag or SQLite",
            "is_goal_reached": None,
        },
    ]
    frame = pl.DataFrame(
        [
            {
                **common,
                **row,
                "file": f"logs/{row['episode_id']}.mcap",
                "sha256": None if row["status"] == "quarantined" else "ab" * 32,
                "start_ns": None if row["status"] == "quarantined" else START_NS,
                "end_ns": None if row["status"] == "quarantined" else START_NS + 30 * 10**9,
            }
            for row in rows
        ],
        infer_schema_length=None,
    )
    columns = list(tables.Episodes.column_names())
    return tables.Episodes.validate(frame.select(columns).sort("episode_id"), cast=True)


OPERATORS = (
    ("reach_1", "Reach", 24, False, (("?hand", "Hand"), ("?cube", "Cube"))),
    ("take_1", "Take", 24, False, (("?hand", "Hand"), ("?cube", "Cube"))),
    (
        "put_1",
        "Put",
        15,
        False,
        (("?hand", "Hand"), ("?cube", "Cube"), ("?below", "Cube"), ("?table", "Table")),
    ),
    (
        "put_2",
        "Put",
        9,
        False,
        (("?hand", "Hand"), ("?cube", "Cube"), ("?table", "Table"), ("?below", "Cube")),
    ),
    ("release_1", "Release", 23, False, (("?hand", "Hand"), ("?cube", "Cube"))),
    ("release_2", "Release", 1, True, (("?hand", "Hand"), ("?cube", "Cube"))),
)
LITERALS = (
    # operator's activity, role, predicate, indices of its parameters, positive, share against, kept
    ("Reach", "precondition", "handOpen", (0,), True, 0.0, True),
    ("Reach", "precondition", "clear", (1,), True, 0.05, True),
    ("Reach", "precondition", "onTop", (1, 1), True, 0.6, False),
    ("Reach", "effect", "graspable", (0, 1), True, 0.1, True),
    ("Reach", "effect", "handMove", (0,), True, 0.0, True),
    ("Take", "precondition", "graspable", (0, 1), True, 0.1, True),
    ("Take", "effect", "inHand", (0, 1), True, 0.0, True),
    ("Take", "effect", "handOpen", (0,), False, 0.0, True),
    ("Put", "precondition", "inHand", (0, 1), True, 0.0, True),
    ("Put", "precondition", "clear", (2,), True, 0.0, True),
    ("Put", "effect", "onTop", (1, 2), True, 0.0, True),
    ("Put", "effect", "onTop", (1, 3), False, 0.0, True),
    ("Put", "effect", "clear", (2,), False, 0.07, True),
    ("Release", "precondition", "inHand", (0, 1), True, 0.0, True),
    ("Release", "effect", "inHand", (0, 1), False, 0.0, True),
    ("Release", "effect", "handOpen", (0,), True, 0.0, True),
)
DOMAIN = """; learned from 12 demonstrations
(define (domain cube-stacking)
  (:requirements :typing :negative-preconditions :action-costs)
  (:types Hand Surface Graspable - object Table - Surface Cube - Graspable WoodenCube - Cube)
  (:predicates (handOpen ?a - Hand) (inHand ?a - Hand ?b - Graspable) (onTop ?a - Graspable ?b - object))
  (:functions (total-cost) - number)
  (:action take_1
    :parameters (?hand - Hand ?cube - Cube)
    :precondition (and (graspable ?hand ?cube) (handOpen ?hand))
    :effect (and (inHand ?hand ?cube) (not (handOpen ?hand)) (increase (total-cost) 12)))
)
"""
GOALS = (
    ("onTop(cube_red,cube_blue)", "one on one"),
    ("onTop(cube_blue,cube_green) & onTop(cube_red,cube_blue)", "three-tower"),
    ("onTop(cube_green,cube_red) & onTop(cube_red,cube_blue)", "tower in an order never shown"),
    ("onTop(cube_green,cube_yellow) & onTop(cube_red,cube_blue)", "two towers of two"),
)


def synthetic_operators():
    """Operators and their literals, one of them quarantined."""
    operators = pl.DataFrame(
        [
            {
                "operator": name,
                "activity": activity,
                "parameters": [{"variable": v, "type": t} for v, t in parameters],
                "n_transitions": n,
                "n_episodes": min(n, 12),
                "n_successes": 0,
                "n_failures": 0,
                "beta": (n + 1) / (n + 2),
                "cost": 100 // n + 1,
                "is_quarantined": is_quarantined,
                "note": "seen once, and contradicted by 23 others" if is_quarantined else None,
            }
            for name, activity, n, is_quarantined, parameters in OPERATORS
        ]
    )
    literals = pl.DataFrame(
        [
            {
                "operator": name,
                "role": role,
                "predicate": predicate,
                "variables": [parameters[min(k, len(parameters) - 1)][0] for k in indices],
                "is_positive": is_positive,
                "n_support": n - round(against * n) - (1 if n > 20 and predicate == "clear" else 0),
                "n_against": round(against * n),
                "n_transitions": n,
                "probability": 1.0 - against,
                "is_kept": is_kept,
                "note": None if is_kept else "contradicted too often",
            }
            for name, activity, n, _, parameters in OPERATORS
            for of, role, predicate, indices, is_positive, against, is_kept in LITERALS
            if of == activity
        ]
    )
    return (
        tables.Operators.validate(operators, cast=True),
        tables.Literals.validate(literals, cast=True),
    )


def synthetic_scores():
    """Segmentation by method, planning over everything, with intervals."""
    rows = []
    for method, accuracy in (("decision_tree", 0.978), ("naive", 0.611), ("rule_tree", 0.943)):
        figures = (
            ("frame_accuracy", 0.0),
            ("macro_f1", -0.02),
            ("f1@10", 0.01),
            ("f1@50", -0.04),
            ("edit", -0.01),
        )
        for metric, more in figures:
            value = accuracy + more
            rows.append(
                ("segmentation", method, "all", metric, value, 24, value - 0.02, min(1.0, value + 0.015))
            )
    rows.append(("planning", "combined domain", "all", "goals_solved", 1.0, 4, 0.398, 1.0))
    rows.append(("planning", "single domains", "all", "domains_solved", 11 / 12, 12, 0.646, 0.985))
    frame = pl.DataFrame(
        [
            dict(zip(("suite", "method", "subject", "metric", "value", "n", "low", "high"), r, strict=True))
            for r in rows
        ]
    ).with_columns(detail=pl.lit(None, dtype=pl.String))
    return tables.Scores.validate(frame, cast=True)


def synthetic_plans(n_domains=13):
    """Every goal with every domain: most are solved, one is impossible, one ran out of time."""
    rows = []
    for d in range(n_domains):
        for g, (goal, _) in enumerate(GOALS):
            outcome = "unsolvable" if (d, g) == (4, 2) else "out_of_time" if (d, g) == (7, 3) else "solved"
            is_solved = outcome == "solved"
            steps = [
                "reach_1(Right_hand,cube_red)",
                "take_1(Right_hand,cube_red)",
                "put_1(Right_hand,cube_red)",
            ]
            rows.append(
                {
                    "domain_id": f"{d:016x}",
                    "problem_id": f"problem-{g}",
                    "attempt": 0,
                    "goal": goal,
                    "outcome": outcome,
                    "is_explained": True,
                    "is_validated": is_solved,
                    "n_operators": 6,
                    "n_steps": 3 * (g + 1) if is_solved else None,
                    "cost": 17 * (g + 1) if is_solved else None,
                    "steps": steps * (g + 1) if is_solved else None,
                    "message": None if is_solved else "no operator makes clear(cube_red) true",
                }
            )
    return tables.Plans.validate(pl.DataFrame(rows, infer_schema_length=None), cast=True)


def synthetic_topics():
    """Two topics of every episode that could be read; one lost some messages."""
    rows = [
        {
            "episode_id": episode,
            "topic": topic,
            "message_type": kind,
            "encoding": "cdr",
            "is_mapped": True,
            "n_messages": 3000,
            "n_rows": 12000 - rejected,
            "n_rejected": rejected,
            "note": "position holds NaN" if rejected else None,
        }
        for episode in (EPISODE, "p2-one-0", "p2-one-1", "p3-cut")
        for topic, kind in (("/tf", "tf2_msgs/msg/TFMessage"), ("/grip", "std_msgs/msg/Float64"))
        for rejected in (7 if (episode, topic) == ("p3-cut", "/tf") else 0,)
    ]
    return tables.Topics.validate(pl.DataFrame(rows), cast=True)


def synthetic_report():
    """A report with every section filled."""
    operators, literals = synthetic_operators()
    episodes = synthetic_episodes()
    activities = pl.concat(
        [synthetic_activities(shift, e) for shift, e in ((7, EPISODE), (-11, "p2-one-0"), (23, "p2-one-1"))]
    )
    truth = pl.concat([synthetic_activities(0, e) for e in (EPISODE, "p2-one-0", "p2-one-1")])
    return ReportContent(
        dataset="cube-stacking",
        description="Three participants stack one and two cubes, with the left and with the right hand.",
        versions=(("demoplan", "0.1.0"), ("dataset", "9f" * 32), ("parameters", "41" * 32)),
        episodes=episodes,
        topics=synthetic_topics(),
        activities=activities,
        truth=truth,
        scores=synthetic_scores(),
        methods=("decision_tree",),
        references=(
            Reference(suite="segmentation", metric="frame_accuracy", value=0.874, source="AIJ 2017"),
        ),
        confusions=(
            Confusion(
                method="decision_tree",
                labels=("Idle", "Put", "Reach", "Release", "Take"),
                counts=(
                    (8100, 3, 41, 37, 0),
                    (2, 1510, 0, 22, 31),
                    (60, 0, 1102, 0, 25),
                    (44, 19, 0, 801, 0),
                    (0, 17, 21, 0, 560),
                ),
            ),
        ),
        operators=operators,
        literals=literals,
        evidence=synthetic_evidence(),
        domains=(
            DomainText(domain_id=f"{12:016x}", name="combined", text=DOMAIN, n_operators=5, is_main=True),
            *(
                DomainText(domain_id=f"{k:016x}", name=f"p{k // 4 + 1}-{k % 4}", text=DOMAIN, n_operators=5)
                for k in range(12)
            ),
        ),
        plans=synthetic_plans(),
        goals=GOALS,
        failures=(
            Failure(kind="segment", subject="p2-one-1 Right_hand", cause="one Take missed: 0.04 s long"),
        ),
    )


@pytest.fixture(scope="session")
def frames():
    return synthetic_frames()


@pytest.fixture(scope="session")
def activities():
    return synthetic_activities(shift_ticks=7)


@pytest.fixture(scope="session")
def truth():
    return synthetic_activities()


@pytest.fixture(scope="session")
def facts():
    return synthetic_facts()


@pytest.fixture(scope="session")
def evidence():
    return synthetic_evidence()


@pytest.fixture(scope="session")
def episodes():
    return synthetic_episodes()


@pytest.fixture(scope="session")
def looks():
    return synthetic_entities()


@pytest.fixture(scope="session")
def report_content():
    return synthetic_report()
