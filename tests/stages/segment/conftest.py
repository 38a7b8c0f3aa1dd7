"""One hand that reaches for a cube, carries it to another place and comes back; the other hand rests."""

from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from demoplan.language.types import TypeHierarchy
from demoplan.tables import Activities, Facts, Frames

ENTITIES = {"Left_hand": "Hand", "Right_hand": "Hand", "cube": "Cube", "bowl": "Bowl", "table": "Table"}
TYPES = TypeHierarchy.of({"Hand": "object", "Table": "Surface", "Cube": "Graspable", "Bowl": "Graspable"})

HOME, THERE, GOAL = np.array([0.0, -0.3, 0.2]), np.array([0.2, 0.0, 0.03]), np.array([0.1, 0.3, 0.03])


def _moves(ticks_s, way):
    """Minimum-jerk motion through (time [s], place) pairs, at rest in each."""
    places = np.repeat(way[0][1][None], len(ticks_s), axis=0)
    for (begin, here), (end, there) in pairwise(way):
        share = np.clip((ticks_s - begin) / (end - begin), 0, 1)[:, None]
        smooth = share**3 * (10 - 15 * share + 6 * share**2)
        during = (ticks_s >= begin)[:, None]
        places = np.where(during, here + smooth * (there - here), places)
    return places


def _demonstration(
    episode_id="e1",
    *,
    rate_hz=100.0,
    seed=0,
    tempo=1.0,
    start_ns=1_000_000_000,
    mirrored=False,
    noise_m=0.0005,
):
    rng = np.random.default_rng(seed)
    at = np.array([0.0, 1.0, 2.0, 2.4, 4.0, 4.4, 5.4, 6.5]) * tempo
    n = int(at[-1] * rate_hz)
    t = np.arange(n) / rate_hz
    hand = _moves(
        t,
        [
            (0, HOME),
            (at[1], HOME),
            (at[2], THERE),
            (at[3], THERE),
            (at[4], GOAL),
            (at[5], GOAL),
            (at[6], HOME),
        ],
    )
    cube = _moves(t, [(0, THERE), (at[3], THERE), (at[4], GOAL)])
    grip = np.clip(1 - np.interp(t, at[[2, 3, 4, 5]], [0, 1, 1, 0]), 0, 1)
    rest = np.repeat(np.array([[0.5, -0.3, 0.2]]), n, axis=0)
    bodies = {
        "Left_hand": (rest, np.ones(n)),
        "Right_hand": (hand, grip),
        "bowl": (np.repeat([[-0.2, 0.2, 0.05]], n, axis=0), None),
        "cube": (cube, None),
        "table": (np.zeros((n, 3)), None),
    }
    ticks = start_ns + np.round(t * 1e9).astype(np.int64)
    sign = np.array([-1.0 if mirrored else 1.0, 1.0, 1.0])
    frames = pl.concat(
        pl.DataFrame(
            {
                "episode_id": [episode_id] * n,
                "entity": [name] * n,
                "tick_ns": ticks,
                "position_xyz_m": ((place + noise_m * rng.standard_normal(place.shape)) * sign).tolist(),
                "orientation_wxyz": [[1.0, 0.0, 0.0, 0.0]] * n,
                "grip": [None] * n if opening is None else opening.tolist(),
                "pose_age_ns": [0] * n,
            },
            schema=Frames.create_empty().schema,
        )
        for name, (place, opening) in bodies.items()
    )
    bound = start_ns + np.round(at * 1e9).astype(np.int64)

    def fact(predicate, arguments, begin, end):
        return {
            "episode_id": episode_id,
            "predicate": predicate,
            "arguments": arguments,
            "start_ns": int(begin),
            "end_ns": int(end),
            "value": "true",
        }

    facts = pl.DataFrame(
        [
            fact("handMove", ["Right_hand"], bound[1], bound[2]),
            fact("actedOn", ["Right_hand", "cube"], bound[1], bound[2]),
            fact("inHand", ["Right_hand", "cube"], bound[2], bound[5]),
            fact("handMove", ["Right_hand"], bound[3], bound[4]),
            fact("handMove", ["Right_hand"], bound[5], bound[6]),
        ],
        schema=Facts.create_empty().schema,
    )
    end_ns = int(ticks[-1]) + round(1e9 / rate_hz)
    edges = [int(start_ns), *(int(b) for b in bound[1:7]), end_ns]
    names = ["Idle", "Reach", "Take", "Put", "Take", "Release", "Idle"]
    acted = [None, "cube", None, None, None, None, None]
    held = [None, None, "cube", "cube", "cube", None, None]
    truth = pl.DataFrame(
        {
            "episode_id": [episode_id] * 8,
            "hand": ["Left_hand", *["Right_hand"] * 7],
            "start_ns": [int(start_ns), *edges[:-1]],
            "end_ns": [end_ns, *edges[1:]],
            "activity": ["Idle", *names],
            "acted_on": [None, *acted],
            "in_hand": [None, *held],
        },
        schema=Activities.create_empty().schema,
    )
    return SimpleNamespace(
        frames=Frames.validate(frames.sort("episode_id", "entity", "tick_ns"), cast=True),
        facts=Facts.validate(facts, cast=True),
        truth=Activities.validate(truth),
        entities=ENTITIES,
        types=TYPES,
    )


def _together(*parts):
    return SimpleNamespace(
        frames=Frames.cast(pl.concat([part.frames for part in parts])),
        facts=Facts.cast(pl.concat([part.facts for part in parts])),
        truth=Activities.cast(pl.concat([part.truth for part in parts])),
        entities=ENTITIES,
        types=TYPES,
    )


@pytest.fixture(scope="session")
def demonstrate():
    """Makes an episode: ``demonstrate("e1", rate_hz=60, tempo=1.2)`` gives frames, facts and truth."""
    return _demonstration


@pytest.fixture(scope="session")
def together():
    """Joins the tables of several episodes."""
    return _together


@pytest.fixture(scope="session")
def three():
    """Three episodes at different tempos."""
    return _together(*(_demonstration(f"e{i}", seed=i, tempo=0.8 + 0.2 * i) for i in range(3)))
