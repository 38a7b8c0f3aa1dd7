"""Made-up but plausible tables: two hands stack four cubes for half a minute, at 100 Hz.

Nothing here is measured: it exists so that views can be tested without a log, a stage or a simulator.
"""

from dataclasses import dataclass

import numpy as np
import polars as pl
import pytest

from demoplan import tables
from demoplan.language.vocabulary import Shape

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
