"""Demonstrations made of symbols: hands, cubes and a table, with the noise that real segments have.

Events of the world and of the segmenter happen at the same nominal instants, each with its own jitter, so that
ends of segments fall before or after the changes that they stand for, as they do in recordings.
"""

import random
from dataclasses import dataclass, field
from itertools import product
from types import SimpleNamespace

import polars as pl
import pytest

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy
from demoplan.stages.ask import ask
from demoplan.stages.compose import compose
from demoplan.stages.contrast import contrast
from demoplan.stages.learn import LearnParams, learn
from demoplan.tables import Activities, Facts, Transitions

TYPES = TypeHierarchy.of(
    {
        "Hand": "object",
        "Table": "Surface",
        "Surface": "object",
        "WoodenCube": "Cube",
        "Cube": "Graspable",
        "Graspable": "object",
    }
)
PREDICATES = (
    Signature("actedOn", ("Hand", "object")),
    Signature("clear", ("Graspable",)),
    Signature("graspable", ("Hand", "Graspable")),
    Signature("handMove", ("Hand",)),
    Signature("handOpen", ("Hand",)),
    Signature("inHand", ("Hand", "Graspable")),
    Signature("inTouch", ("Graspable", "object")),
    Signature("onTop", ("Graspable", "object")),
)
HANDS = ("Left_hand", "Right_hand")
CUBES = ("cube_blue", "cube_green", "cube_red", "cube_yellow")
ENTITIES = {**dict.fromkeys(HANDS, "Hand"), **dict.fromkeys(CUBES, "WoodenCube"), "table": "Table"}


@dataclass(frozen=True, kw_only=True)
class Habits:
    """How a participant moves, and how badly the recording shows it."""

    jitter_s: float = 0.04
    hesitation: float = 0.2
    regrasp: float = 0.1
    missed_segment: float = 0.03
    bystander: float = 0.3
    skips_idle: float = 0.3
    late_start: float = 0.1
    early_stop: float = 0.1
    flips: float = 0.0
    wrong_names: float = 0.0


@dataclass
class Recorder:
    """Collects events; then makes tables of them."""

    rng: random.Random
    habits: Habits
    events: list = field(default_factory=list)
    rows: list = field(default_factory=list)

    def jitter(self):
        return self.rng.gauss(0.0, self.habits.jitter_s)

    def set(self, at_s, predicate, *names, on=True):
        at_s += self.jitter()
        self.events.append((at_s, on, Atom(predicate, names)))
        if predicate == "onTop" and names[1] != "table":
            # Derived, and so at the same instant.
            self.events.append((at_s, not on, Atom("clear", (names[1],))))
        if predicate == "inHand":
            self.events.append((at_s, not on, Atom("clear", (names[1],))))

    def segment(self, start_s, activity, acted_on=None, in_hand=None):
        self.rows.append([start_s, activity, acted_on, in_hand])


def demonstrate(episode_id, moves, hand, seed, habits=Habits(), start=None):
    """Activities and facts of one demonstration that moves cubes one after the other.

    Args:
        episode_id: Its name.
        moves: (cube, support) pairs, in order.
        hand: The hand that acts; the other is idle.
        seed: For all chance.
        habits: Noise.
        start: What each cube stands on at first; the table by default.
    """
    rng = random.Random(seed)
    rec = Recorder(rng, habits)
    on = dict(start or dict.fromkeys(CUBES, "table"))
    for cube, support in on.items():
        for predicate in ("onTop", "inTouch"):
            rec.events.append((-1.0, True, Atom(predicate, (cube, support))))
    for cube in CUBES:
        if cube not in on.values():
            rec.events.append((-1.0, True, Atom("clear", (cube,))))
    for each in HANDS:
        rec.events.append((-1.0, True, Atom("handOpen", (each,))))
    t = 0.0
    if rng.random() >= habits.late_start:
        rec.segment(t, "Idle")
        t += rng.uniform(0.4, 1.0)
    for number, (cube, to) in enumerate(moves):
        source = on[cube]
        tries = 2 if rng.random() < habits.regrasp else 1
        for attempt in range(tries):
            # Reach
            rec.segment(t, "Reach", acted_on=cube)
            rec.set(t, "handMove", hand)
            span = rng.uniform(0.6, 1.2)
            rec.set(t + 0.4 * span, "actedOn", hand, cube)
            rec.set(t + 0.8 * span, "graspable", hand, cube)
            t += span
            # Take
            rec.segment(t, "Take", acted_on=cube, in_hand=cube)
            rec.set(t + 0.01, "handMove", hand, on=False)
            rec.set(t + 0.05, "actedOn", hand, cube, on=False)
            rec.set(t + 0.06, "handOpen", hand, on=False)
            rec.set(t + 0.06, "graspable", hand, cube, on=False)
            if attempt < tries - 1:
                span = rng.uniform(0.3, 0.6)
                rec.set(t + span, "handOpen", hand)
                rec.set(t + span, "graspable", hand, cube, on=False)
                t += span
                continue
            rec.set(t + 0.12, "inHand", hand, cube)
            t += rng.uniform(0.3, 0.6)
        # Put
        rec.segment(t, "Put", acted_on=to, in_hand=cube)
        rec.set(t + 0.01, "handMove", hand)
        rec.set(t + 0.05, "onTop", cube, source, on=False)
        rec.set(t + 0.05, "inTouch", cube, source, on=False)
        t += rng.uniform(0.3, 0.6)
        rec.set(t, "actedOn", hand, to)
        if rng.random() < habits.hesitation:
            rec.segment(t + 0.1, "Take", acted_on=cube, in_hand=cube)
            rec.set(t + 0.1, "handMove", hand, on=False)
            t += rng.uniform(0.2, 0.5)
            rec.segment(t + 0.1, "Put", acted_on=to, in_hand=cube)
            rec.set(t + 0.1, "handMove", hand)
        t += rng.uniform(0.4, 0.8)
        rec.set(t - 0.05, "onTop", cube, to)
        rec.set(t - 0.05, "inTouch", cube, to)
        if to != "table":
            rec.set(t - 0.05, "inTouch", to, cube)
        rec.set(t, "actedOn", hand, to, on=False)
        on[cube] = to
        # Release
        rec.segment(t, "Release")
        rec.set(t + 0.05, "inHand", hand, cube, on=False)
        rec.set(t + 0.09, "handOpen", hand)
        rec.set(t + 0.09, "graspable", hand, cube)
        rec.set(t + 0.4, "graspable", hand, cube, on=False)
        t += rng.uniform(0.4, 0.8)
        is_last = number == len(moves) - 1
        if is_last or rng.random() >= habits.skips_idle:
            rec.segment(t, "Idle")
            rec.set(t + 0.01, "handMove", hand, on=False)
            t += rng.uniform(0.3, 0.8)
    end = t
    others = list(CUBES)
    for _ in range(int(habits.bystander * 20)):
        at, cube = rng.uniform(0, end), rng.choice(others)
        atom = rng.choice(
            [
                Atom("inTouch", (cube, rng.choice(others))),
                Atom("actedOn", (hand, cube)),
                Atom("graspable", (hand, cube)),
            ]
        )
        if len(set(atom.arguments)) == 2:
            rec.events += [(at, True, atom), (at + rng.uniform(0.05, 1.0), False, atom)]
    return _tables(episode_id, rec, hand, end)


def _tables(episode_id, rec, hand, end_s):
    rng, habits = rec.rng, rec.habits
    rows = [row for place, row in enumerate(rec.rows) if place == 0 or rng.random() >= habits.missed_segment]
    if rng.random() < habits.early_stop and rows[-1][1] == "Idle" and len(rows) > 1:
        end_s = rows[-1][0]
        rows = rows[:-1]
    starts = [row[0] + (rec.jitter() if place else 0.0) for place, row in enumerate(rows)]
    names = ("Idle", "Reach", "Take", "Put", "Release")
    activities = []
    for place, row in enumerate(rows):
        name = rng.choice(names) if rng.random() < habits.wrong_names else row[1]
        start = starts[place]
        end = starts[place + 1] if place + 1 < len(rows) else end_s
        if end - start < 0.02:
            continue
        activities.append((episode_id, hand, _ns(start), _ns(end), name, row[2], row[3]))
    other = next(each for each in HANDS if each != hand)
    activities.append((episode_id, other, _ns(activities[0][2] / 1e9), _ns(end_s), "Idle", None, None))
    facts = []
    begun = {}
    for event_s, is_on, atom in sorted(rec.events, key=lambda event: event[:2]):
        at = min(max(event_s, activities[0][2] / 1e9), end_s)
        if is_on:
            begun.setdefault(atom, at)
        elif atom in begun:
            facts.append((atom, begun.pop(atom), at))
    facts += [(atom, at, end_s) for atom, at in begun.items()]
    table = [
        (episode_id, atom.predicate, list(atom.arguments), _ns(a), _ns(b), "true")
        for atom, a, b in facts
        if _ns(a) < _ns(b)
    ]
    return (
        Activities.validate(pl.DataFrame(activities, schema=Activities.create_empty().schema, orient="row")),
        Facts.validate(pl.DataFrame(table, schema=Facts.create_empty().schema, orient="row")),
    )


def _ns(seconds):
    return round(seconds * 1e9)


TASKS = {
    "one_left": ([("cube_red", "cube_blue")], "Left_hand"),
    "one_right": ([("cube_red", "cube_blue")], "Right_hand"),
    "two_left": ([("cube_red", "cube_blue"), ("cube_green", "cube_red")], "Left_hand"),
    "two_right": ([("cube_red", "cube_blue"), ("cube_green", "cube_red")], "Right_hand"),
}


def transitions_of(*demonstrations):
    activities = pl.concat([each[0] for each in demonstrations])
    facts = pl.concat([each[1] for each in demonstrations])
    return contrast(Activities.validate(activities), Facts.validate(facts), ENTITIES)


def study(seed=0, participants=3, habits=Habits()):
    """The paper's study: each participant stacks one and two cubes, with the left and the right hand."""
    return {
        f"p{who}_{task}": demonstrate(f"p{who}_{task}", moves, hand, f"{seed}/{who}/{task}", habits)
        for who in range(participants)
        for task, (moves, hand) in TASKS.items()
    }


def every_atom(objects):
    """Canonical text of every atom that types allow over (name, type) pairs, none of them named twice."""
    atoms = []
    for signature in PREDICATES:
        places = [[n for n, t in objects if TYPES.is_subtype(t, kind)] for kind in signature.argument_types]
        atoms += [f"{signature.name}({','.join(a)})" for a in product(*places) if len(set(a)) == len(a)]
    return sorted(atoms)


def corrupted(transitions, seed, flips=0.05, wrong_names=0.1):
    """Transitions with so many activities misnamed, and at each end of one so many atoms misread.

    Every atom that the objects' types allow is misread on its own. An end is read once: what comes after one
    activity is what came before the next.
    """
    rng = random.Random(seed)
    names = sorted(set(transitions["activity"]))
    universes, rows, last = {}, [], None
    for row in transitions.sort("episode_id", "hand", "start_ns").iter_rows(named=True):
        objects = tuple((each["name"], each["type"]) for each in row["objects"])
        universe = universes.setdefault(objects, every_atom(objects))
        track = (row["episode_id"], row["hand"])
        is_next = last is not None and last[0] == track

        def misread(state, universe=universe):
            return sorted(set(state) ^ {atom for atom in universe if rng.random() < flips})

        before, previous = last[1:] if is_next else (misread(row["before"]), None)
        name = row["activity"]
        if rng.random() < wrong_names:
            name = rng.choice([each for each in names if each != name])
        last = (track, misread(row["after"]), name)
        rows.append(
            row | {"before": before, "after": last[1], "activity": name, "previous_activity": previous}
        )
    return Transitions.validate(pl.DataFrame(rows, schema=transitions.schema))


def domain_of(transitions, params=LearnParams()):
    learned = learn(transitions, TYPES, PREDICATES, params)
    return compose(learned.operators, learned.literals, TYPES, PREDICATES, "stacking")


GOALS = {
    "one on one": ("onTop({0},{1})",),
    "tower of three": ("onTop({0},{1})", "onTop({1},{2})"),
    "tower of four": ("onTop({0},{1})", "onTop({1},{2})", "onTop({2},{3})"),
    "two towers of two": ("onTop({0},{1})", "onTop({2},{3})"),
}


def problem_of(domain, kind, rng, hands=HANDS):
    """Four cubes on the table, some beside each other, in the words of the domain."""
    cubes = rng.sample(CUBES, 4)
    state = {Atom("handOpen", (hand,)) for hand in hands}
    for cube in cubes:
        state |= {Atom("onTop", (cube, "table")), Atom("inTouch", (cube, "table")), Atom("clear", (cube,))}
    for one in cubes:
        for other in cubes:
            if one < other and rng.random() < 0.15:
                state |= {Atom("inTouch", (one, other)), Atom("inTouch", (other, one))}
    goal = [Literal(Atom.parse(text.format(*cubes))) for text in GOALS[kind]]
    objects = {
        name: type_name for name, type_name in ENTITIES.items() if type_name != "Hand" or name in hands
    }
    return ask(domain, state, objects, goal, "stack")


class Tabletop:
    """Cubes, hands and a table, by the laws of physics alone: knows nothing of operators' conditions."""

    def __init__(self, problem):
        self.on = {a.arguments[0]: a.arguments[1] for a in problem.initial if a.predicate == "onTop"}
        self.held = {}

    def wrong(self, adds, deletes):
        """What is impossible about a step that makes these changes; empty if nothing is."""
        for atom in sorted(deletes):
            if atom.predicate == "inHand" and self.held.get(atom.arguments[0]) == atom.arguments[1]:
                del self.held[atom.arguments[0]]
        for atom in sorted(adds):
            if atom.predicate == "inHand":
                hand, cube = atom.arguments
                if hand in self.held:
                    return f"{hand} holds {self.held[hand]} and cannot take {cube}"
                if cube in self.held.values():
                    return f"{cube} is in another hand"
                if cube in self.on.values():
                    return f"{cube} is under another"
                self.held[hand] = cube
            if atom.predicate == "handOpen" and atom.arguments[0] in self.held:
                return f"{atom.arguments[0]} opens, and still is said to hold"
        moved = [atom.arguments for atom in sorted(adds) if atom.predicate == "onTop"]
        for cube, to in moved:
            if cube not in self.held.values() and Atom("inHand", ()) not in deletes:
                released = [a for a in deletes if a.predicate == "inHand" and a.arguments[1] == cube]
                if not released:
                    return f"{cube} moves by itself"
            if Atom("onTop", (cube, self.on[cube])) not in deletes:
                return f"{cube} is still on {self.on[cube]}"
            if cube in self.on.values():
                return f"{cube} is moved from under another"
            if to == cube or (to != "table" and to in self.on.values()):
                return f"{to} is covered, or the cube itself"
            self.on[cube] = to
        if len(moved) > 1:
            return "two cubes at once"
        return ""

    def reaches(self, goal):
        return all(self.on.get(lit.atom.arguments[0]) == lit.atom.arguments[1] for lit in goal)


@pytest.fixture(scope="session")
def table_world():
    """Everything above, for tests."""
    return SimpleNamespace(**{name: value for name, value in globals().items() if not name.startswith("__")})
