"""Worlds about what demonstrators avoid: in two of them because they must, in two because they would rather.

In ``kiln`` and ``pier`` conditions are negative. In ``porter`` and ``museum`` none is, but demonstrators have
habits: what they avoid can be done, and test problems need it. No learner can tell a habit that is never
broken from a rule; these are broken now and then, or were given few chances.
"""

import itertools
import random
from collections.abc import Callable

from own_worlds import World

Fact = tuple[str, ...]
Habit = Callable[[Fact, set[Fact]], float]
"""How gladly a ground action is chosen in a state, against others of its name."""


def kiln(draw: random.Random) -> World:
    pots, kilns = [f"pot{n}" for n in range(1, draw.randint(3, 5) + 1)], ["kiln1", "kiln2"]
    shelves = [f"shelf{n}" for n in range(1, 4)]
    state: set[Fact] = {("on", pot, draw.choice(shelves)) for pot in pots}
    for word, share in (("wet", 0.4), ("cracked", 0.35), ("tall", 0.4), ("glazed", 0.2)):
        state |= {(word, pot) for pot in pots if draw.random() < share}
    state |= {("hot", each) for each in kilns if draw.random() < 0.4}
    objects = dict.fromkeys(pots, "pot") | dict.fromkeys(kilns, "kiln") | dict.fromkeys(shelves, "shelf")
    return objects, state, {"in", "fired", "glazed"}


def pier(draw: random.Random) -> World:
    piers, boats = [f"pier{n}" for n in range(1, draw.randint(3, 4) + 1)], ["gull", "tern"]
    people = [f"p{n}" for n in range(1, draw.randint(3, 5) + 1)]
    pairs = [*itertools.pairwise(piers), (piers[-1], piers[0])]
    state: set[Fact] = {("route", *pair) for one in pairs for pair in (one, one[::-1])}
    state |= {("at", boat, draw.choice(piers)) for boat in boats}
    state |= {("waits", one, draw.choice(piers)) for one in people}
    state |= {("ill", one) for one in people if draw.random() < 0.35}
    state |= {("closed", each) for each in piers if draw.random() < 0.3} | {("old", "gull")}
    if draw.random() < 0.3:
        state.add(("fog",))
    objects = dict.fromkeys(piers, "pier") | dict.fromkeys(boats, "boat") | dict.fromkeys(people, "person")
    return objects, state, {"at", "waits"}


def porter(draw: random.Random) -> World:
    rooms = [f"room{n}" for n in range(1, draw.randint(4, 5) + 1)]
    parcels, porters = [f"parcel{n}" for n in range(1, draw.randint(3, 4) + 1)], ["ann", "bob"]
    pairs = [*itertools.pairwise(rooms), (rooms[0], rooms[-1])]
    state: set[Fact] = {("door", *pair) for one in pairs for pair in (one, one[::-1])}
    state |= {("at", each, draw.choice(rooms)) for each in porters} | {("free", each) for each in porters}
    state |= {("in", each, draw.choice(rooms)) for each in parcels}
    state |= {("dark", each) for each in rooms if draw.random() < 0.35}
    state |= {("noisy", each) for each in rooms if draw.random() < 0.35}
    state |= {("heavy", each) for each in parcels if draw.random() < 0.4}
    objects = (
        dict.fromkeys(rooms, "room") | dict.fromkeys(parcels, "parcel") | dict.fromkeys(porters, "porter")
    )
    return objects, state, {"at", "in", "stamped"}


def museum(draw: random.Random) -> World:
    rooms = [f"room{n}" for n in range(1, 6)]
    exhibits, carts = [f"x{n}" for n in range(1, draw.randint(5, 7) + 1)], ["cart1", "cart2"]
    state: set[Fact] = {("joins", *pair) for one in itertools.pairwise(rooms) for pair in (one, one[::-1])}
    state |= {("at", cart, draw.choice(rooms[:2])) for cart in carts} | {("rusty", "cart2")}
    for number, each in enumerate(exhibits):
        is_fragile = number % 3 == 0
        state.add(("shown", each, draw.choice(rooms[3:] if is_fragile else rooms[:4])))
        state |= {("fragile", each)} if is_fragile else set()
        state |= {("loaned", each)} if draw.random() < 0.3 else set()
    state |= {("armed", each) for each in rooms if draw.random() < 0.3}
    objects = dict.fromkeys(rooms, "room") | dict.fromkeys(exhibits, "exhibit") | dict.fromkeys(carts, "cart")
    return objects, state, {"at", "shown", "packed"}


def porters_habit(action: Fact, state: set[Fact]) -> float:
    name, *arguments = action
    if name == "pick":
        return 0.05 if ("heavy", arguments[1]) in state else 1.0
    return 0.15 if name == "go" and ("dark", arguments[2]) in state else 1.0


def museums_habit(action: Fact, state: set[Fact]) -> float:
    name, *arguments = action
    if name == "lift":
        return 0.1 if ("loaned", arguments[0]) in state else 1.0
    return 0.1 if name == "push" and ("armed", arguments[2]) in state else 1.0


AVOIDING = {"kiln": kiln, "museum": museum, "pier": pier, "porter": porter}
HABITS: dict[str, Habit] = {"museum": museums_habit, "porter": porters_habit}
