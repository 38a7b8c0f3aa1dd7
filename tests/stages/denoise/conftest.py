"""A small world whose rules are known: a courier with keys, rooms and parcels, walked at random, and misread."""

import random

import pytest

from demoplan.language.traces import TraceReader, read_signatures

DOMAIN = """(define (domain Courier) (:types courier parcel room - object)
(:predicates (at ?c - courier ?r - room) (in ?p - parcel ?r - room) (carries ?c - courier ?p - parcel)
 (free ?c - courier) (door ?a ?b - room) (lit ?r - room) (stamped ?p - parcel) (heavy ?p - parcel))
(:action go :parameters (?c - courier ?a - room ?b - room))
(:action pick :parameters (?c - courier ?p - parcel ?r - room))
(:action drop :parameters (?c - courier ?p - parcel ?r - room))
(:action stamp :parameters (?c - courier ?p - parcel))
(:action vanish :parameters (?p - parcel)))
"""
RULES = {
    "go": ({"at(?c,?a)", "door(?a,?b)"}, {"at(?c,?b)", "not at(?c,?a)"}),
    "pick": (
        {"at(?c,?r)", "in(?p,?r)", "free(?c)"},
        {"carries(?c,?p)", "not in(?p,?r)", "not free(?c)"},
    ),
    "drop": (
        {"at(?c,?r)", "carries(?c,?p)"},
        {"in(?p,?r)", "free(?c)", "not carries(?c,?p)"},
    ),
    # A parcel may be stamped again: the effect is added whether it held or not.
    "stamp": ({"carries(?c,?p)"}, {"stamped(?p)"}),
}
ROOMS, PARCELS, COURIERS = ("r1", "r2", "r3", "r4"), ("p1", "p2", "p3"), ("c1", "c2")
DOORS = {("r1", "r2"), ("r2", "r1"), ("r2", "r3"), ("r3", "r2"), ("r3", "r4"), ("r4", "r3")}
OBJECTS = {
    **dict.fromkeys(ROOMS, "room"),
    **dict.fromkeys(PARCELS, "parcel"),
    **dict.fromkeys(COURIERS, "courier"),
}
ATOMS = sorted(
    {("at", c, r) for c in COURIERS for r in ROOMS}
    | {("in", p, r) for p in PARCELS for r in ROOMS}
    | {("carries", c, p) for c in COURIERS for p in PARCELS}
    | {("free", c) for c in COURIERS}
    | {("door", a, b) for a in ROOMS for b in ROOMS}
    | {("lit", r) for r in ROOMS}
    | {("stamped", p) for p in PARCELS}
    | {("heavy", p) for p in PARCELS}
)


def walk(seed, length=25, barred=None):
    """States and actions of a random walk; parcels of which ``barred`` holds are never picked up."""
    draw = random.Random(seed)
    state = {("door", *pair) for pair in DOORS} | {("lit", r) for r in ROOMS if draw.random() < 0.5}
    state |= {("heavy", p) for p in PARCELS if draw.random() < 0.5} | {("free", c) for c in COURIERS}
    state |= {("at", c, draw.choice(ROOMS)) for c in COURIERS} | {
        ("in", p, draw.choice(ROOMS)) for p in PARCELS
    }
    states, actions = [set(state)], []
    for _ in range(length):
        options = []
        for c in COURIERS:
            (here,) = (r for r in ROOMS if ("at", c, r) in state)
            held = [p for p in PARCELS if ("carries", c, p) in state]
            options += [("go", c, here, b) for a, b in sorted(DOORS) if a == here]
            options += [("drop", c, p, here) for p in held] + [("stamp", c, p) for p in held]
            options += [
                ("pick", c, p, here)
                for p in PARCELS
                if not held and ("in", p, here) in state and (barred, p) not in state
            ] * 2
        action = draw.choice(options)
        name, c, *rest = action
        if name == "go":
            state = state - {("at", c, rest[0])} | {("at", c, rest[1])}
        elif name == "pick":
            state = state - {("in", *rest), ("free", c)} | {("carries", c, rest[0])}
        elif name == "drop":
            state = state - {("carries", c, rest[0])} | {("in", *rest), ("free", c)}
        else:
            state = state | {("stamped", rest[0])}
        states.append(set(state))
        actions.append(action)
    return states, actions


def text_of(states, actions, rate=0.0, seed=0, hidden=0.0):
    """The walk as a file's text; with flips; or partial, with some atoms left unsaid."""
    draw = random.Random(f"flip {seed}")
    parts = ["(:trajectory"]
    for number, state in enumerate(states):
        flipped = {atom for atom in ATOMS if draw.random() < rate}
        seen = state ^ flipped
        literals = [f"({' '.join(atom)})" for atom in sorted(seen)]
        if hidden:
            literals = [
                f"({' '.join(atom)})" if atom in seen else f"(not ({' '.join(atom)}))"
                for atom in ATOMS
                if draw.random() >= hidden
            ]
        parts.append(f"(:state {' '.join(literals)})")
        if number < len(actions):
            parts.append(f"(:action ({' '.join(actions[number])}))")
    return "\n".join(parts) + "\n)\n"


@pytest.fixture(scope="session")
def courier():
    """Makes trace sets: ``courier(n_traces, rate=…)``."""

    def make(numbers, length=25, barred=None, **noise):
        signatures, _ = read_signatures(DOMAIN, "domain.pddl")
        reader = TraceReader(signatures)
        for number in range(numbers) if isinstance(numbers, int) else numbers:
            reader.add(
                text_of(*walk(number, length, barred), seed=number, **noise), f"{number}_traj", OBJECTS
            )
        assert reader.faults == ()
        return reader.take()

    return make


@pytest.fixture(scope="session")
def rules():
    """What each action truly needs and does, as text."""
    return RULES


@pytest.fixture(scope="session")
def learned():
    """What was learned, in the same form as the rules."""

    def text(denoised):
        return {
            name: ({str(each) for each in pre}, {str(each) for each in effects})
            for name, (pre, effects) in denoised.actions().items()
        }

    return text


@pytest.fixture(scope="session")
def courier_one_by_one():
    """Seven noisy walks, each a trace set of its own from one reader."""
    signatures, _ = read_signatures(DOMAIN, "domain.pddl")
    reader, pieces = TraceReader(signatures), []
    for number in range(7):
        reader.add(text_of(*walk(number), seed=number, rate=0.1), f"{number}_traj", OBJECTS)
        pieces.append(reader.take())
    return pieces
