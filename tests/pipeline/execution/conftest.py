"""A session without physics: hands go where they are told, objects follow the hand that holds them.

It serves to test the executor in milliseconds, and to let exactly one thing go wrong.
"""

from pathlib import Path

import numpy as np
import polars as pl
import pytest

from demoplan.engines.mujoco.scene_spec import ObjectSpec, SceneSpec
from demoplan.engines.mujoco.session import (
    MotionReport,
    ObjectDropped,
    ObjectMoved,
    ObjectRemoved,
    PlacingOffset,
)
from demoplan.language.pddl import parse_domain
from demoplan.manifests.vocabulary import parse_vocabulary
from demoplan.tables import Frames

CHECKOUT = Path(__file__).resolve().parents[3]

STEP_NS = 20_000_000
SPEED = 0.5


def cubes(*names, spacing_m=0.15):
    return SceneSpec(
        objects=tuple(
            ObjectSpec(name=name, position_xyz_m=(0.0, spacing_m * (k - len(names) / 2), 0.025))
            for k, name in enumerate(names)
        )
    )


class KinematicSession:
    """As :class:`demoplan.engines.mujoco.session.Session`, by kinematics alone."""

    robot = "kinematic"

    def __init__(self, scene, hands=("Right_hand",), seed=0, *, highest_m=1.0, failing=()):
        self.scene, self.hands, self.highest_m = scene, tuple(hands), highest_m
        self.time_ns = 0
        self.injected = []
        self._rng = np.random.default_rng(seed)
        self._failing = list(failing)
        self._place = {each.name: np.array(each.position_xyz_m) for each in scene.objects}
        self._size = {each.name: np.array(each.size_xyz_m) for each in scene.objects}
        self._hand = {hand: np.array([0.0, 0.3 + 0.2 * k, 0.3]) for k, hand in enumerate(self.hands)}
        self._grip = dict.fromkeys(self.hands, 1.0)
        self._held = dict.fromkeys(self.hands)
        self._way = {hand: [] for hand in self.hands}
        self._end = dict.fromkeys(self.hands)
        self._report = dict.fromkeys(self.hands)
        self._offset = dict.fromkeys(self.hands, (0.0, 0.0, 0.0))
        self._gone = set()
        self._falling = {}
        self._rows = []
        self.n_started = 0
        for _ in range(30):
            self._note()

    def start(self, hand, motion):
        self.n_started += 1
        place = self._place.get(motion.object)
        if motion.skill == "reach":
            way, end = [place + np.array([0, 0, 0.15]), place], None
        elif motion.skill == "grasp":
            way, end = [None] * 20, lambda own: own._grasp(hand, motion.object)
        elif motion.skill == "carry":
            if motion.support == "table":
                target = np.array([0.3, -0.3, self._size[motion.object][2] / 2])
            else:
                rise = (self._size[motion.object][2] + self._size[motion.support][2]) / 2
                target = self._place[motion.support] + [0, 0, rise]
            target = target + self._offset[hand]
            self._offset[hand] = (0.0, 0.0, 0.0)
            above = np.array([0, 0, 0.2])
            way, end = [self._hand[hand] + above, target + above, target], None
        elif motion.skill == "release":
            way, end = [None] * 20, lambda own: own._release(hand)
        else:
            way, end = [np.array([0.0, 0.4, 0.3])], lambda own: own._grip.update({hand: 1.0})
        self._way[hand], self._end[hand] = way, end
        self._report[hand] = {
            "motion": motion,
            "state": "running",
            "problem": None,
            "reason": None,
            "start": self.time_ns,
            "end": None,
        }
        if self._failing and self._failing[0] == motion.skill:
            self._failing.pop(0)
            self._way[hand] = [None] * 5
            self._end[hand] = None
            self._report[hand] |= {"fails": True}
        return self.report(hand)

    def _grasp(self, hand, name):
        self._grip[hand] = 0.0
        if name not in self._gone and np.linalg.norm(self._place[name] - self._hand[hand]) < 0.02:
            self._held[hand] = name

    def _release(self, hand):
        self._grip[hand] = 1.0
        name, self._held[hand] = self._held[hand], None
        if name is not None:
            self._fall(name)
        self._hand[hand] = self._hand[hand] + [0, 0, 0.12]

    def _fall(self, name):
        """Down to what is beneath its middle; off the edge of it, to the table."""
        place, half = self._place[name].copy(), self._size[name][2] / 2
        tops = [
            self._place[o][2] + self._size[o][2] / 2
            for o in self._place
            if o != name
            and o not in self._gone
            and np.all(np.abs(self._place[o][:2] - place[:2]) < self._size[o][:2] / 2)
            and self._place[o][2] < place[2]
        ]
        if not tops:
            # What misses its support lands beside it.
            near = [
                o for o in self._place if o != name and np.linalg.norm(self._place[o][:2] - place[:2]) < 0.05
            ]
            for o in near:
                away = place[:2] - self._place[o][:2]
                place[:2] = self._place[o][:2] + away / np.linalg.norm(away) * 0.07
        place[2] = max(tops, default=0.0) + half
        self._falling[name] = place

    def advance(self, duration_s):
        for _ in range(max(1, round(duration_s * 1e9 / STEP_NS))):
            self.time_ns += STEP_NS
            for hand in self.hands:
                self._move(hand)
            for name, target in list(self._falling.items()):
                step = target - self._place[name]
                length = np.linalg.norm(step)
                self._place[name] = self._place[name] + step * min(1.0, 0.02 / max(length, 1e-9))
                if length <= 0.02:
                    del self._falling[name]
            self._note()

    def _move(self, hand):
        way, report = self._way[hand], self._report[hand]
        if report is None or report["state"] != "running":
            return
        if way and way[0] is None:
            way.pop(0)
        elif way:
            step = way[0] - self._hand[hand]
            length = np.linalg.norm(step)
            limit = SPEED * STEP_NS / 1e9
            self._hand[hand] = self._hand[hand] + step * min(1.0, limit / max(length, 1e-9))
            if length <= limit:
                way.pop(0)
        if self._held[hand]:
            self._place[self._held[hand]] = self._hand[hand].copy()
        if not way:
            if self._end[hand]:
                self._end[hand](self)
            failed = report.get("fails", False)
            report |= {
                "state": "failed" if failed else "succeeded",
                "problem": "path_blocked" if failed else None,
                "reason": "something is in the way" if failed else None,
                "end": self.time_ns,
            }

    def report(self, hand):
        r = self._report[hand]
        return (
            None
            if r is None
            else MotionReport(
                motion=r["motion"],
                state=r["state"],
                problem=r["problem"],
                reason=r["reason"],
                tracking_error_m=0.001,
                peak_force_n=1.0,
                n_collisions=0,
                started_ns=r["start"],
                ended_ns=r["end"],
            )
        )

    def cancel(self, hand):
        self._way[hand] = []
        self._report[hand] |= {"state": "cancelled", "end": self.time_ns}

    def inject(self, fault):
        self.injected.append((self.time_ns, fault))
        if isinstance(fault, ObjectMoved):
            self._held = {hand: None if name == fault.object else name for hand, name in self._held.items()}
            self._place[fault.object] = np.array(fault.position_xyz_m)
        elif isinstance(fault, ObjectRemoved):
            self._gone.add(fault.object)
        elif isinstance(fault, PlacingOffset):
            self._offset[fault.hand] = fault.offset_xyz_m
        elif isinstance(fault, ObjectDropped):
            self._grip[fault.hand] = 1.0
            name, self._held[fault.hand] = self._held[fault.hand], None
            if name:
                self._fall(name)
        else:
            raise NotImplementedError(fault)

    def _note(self):
        tick = (len(self._rows) - 30) * STEP_NS
        poses = self._hand | self._place
        self._rows.append(
            (
                tick,
                {n: None if n in self._gone else p + self._rng.normal(0, 3e-4, 3) for n, p in poses.items()},
                dict(self._grip),
                {n: p.copy() for n, p in poses.items()},
            )
        )

    def _table(self, since_ns, column):
        rows = [r for r in self._rows if r[0] > since_ns]
        names = sorted([*self.hands, *self._place])
        data = {
            "episode_id": ["run"] * len(rows) * len(names),
            "entity": [n for n in names for _ in rows],
            "tick_ns": [r[0] for _ in names for r in rows],
            "position_xyz_m": [
                None if r[column][n] is None or (n in self._gone and column == 3) else r[column][n].tolist()
                for n in names
                for r in rows
            ],
            "orientation_wxyz": [[1.0, 0.0, 0.0, 0.0] for _ in names for _ in rows],
            "grip": [r[2].get(n) for n in names for r in rows],
            "pose_age_ns": [0 for _ in names for _ in rows],
        }
        return pl.DataFrame(data, schema={name: c.dtype for name, c in Frames.columns().items()})

    def frames(self, since_ns=-1):
        return self._table(max(since_ns, -(10**18)), 1)

    def true_frames(self, since_ns=-1):
        return self._table(since_ns, 3)

    def is_resting_on(self, name, support):
        if name in self._gone or support in self._gone or name in self._held.values():
            return False
        bottom = self._place[name][2] - self._size[name][2] / 2
        if support == "table":
            return abs(bottom) < 0.004
        aside = np.abs(self._place[name][:2] - self._place[support][:2])
        top = self._place[support][2] + self._size[support][2] / 2
        return bool(abs(bottom - top) < 0.004 and np.all(aside < self._size[support][:2] / 2))

    def can_reach(self, hand, position_xyz_m):
        return None if position_xyz_m[2] <= self.highest_m else f"it is higher than {self.highest_m} m"


@pytest.fixture
def new_session():
    """Makes sessions without physics."""
    return KinematicSession


@pytest.fixture
def four_cubes():
    """A scene with four cubes in a row."""
    return cubes("cube_red", "cube_blue", "cube_green", "cube_yellow")


@pytest.fixture(scope="session")
def learned_domain():
    """What was learned from the twelve shipped demonstrations together."""
    return parse_domain((CHECKOUT / "tests/golden/execution/learned-domain.pddl").read_text())


@pytest.fixture(scope="session")
def tabletop():
    path = CHECKOUT / "schemas/vocabularies/tabletop.yaml"
    return parse_vocabulary(path.read_text(), path)
