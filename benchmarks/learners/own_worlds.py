"""Worlds for the domains in ``domains/``, which were written to have shapes that the public ones lack.

Predicates of three arguments and of none, constants, deep hierarchies, many objects, negative conditions that
matter, parameters that may be the same object. No learner was developed on them.
"""

import itertools
import random

World = tuple[dict[str, str], set[tuple[str, ...]], set[str]]
"""Objects with types, the initial state, and the predicates that goals are about."""


def workshop(draw: random.Random) -> World:
    places = ["counter", "bench1", *(f"shelf{n}" for n in range(1, draw.randint(2, 3) + 1))]
    tools, machines = ["saw", "drill", "file"], ["lathe", "mill"]
    parts = [f"part{n}" for n in range(1, draw.randint(3, 5) + 1)]
    state: set[tuple[str, ...]] = {("hand_free",), ("here", draw.choice(places))}
    order = draw.sample(places, len(places))
    pairs = [*itertools.pairwise(order), (order[0], order[-1])]
    state |= {("near", *pair) for one in pairs for pair in (one, one[::-1])}
    state |= {("stands", machine, draw.choice(places)) for machine in machines}
    state |= {("idle", machine) for machine in machines}
    state |= {("at", thing, draw.choice(places)) for thing in (*tools, *parts)}
    state |= {("needs", part, draw.choice(tools), machine) for part in parts for machine in machines}
    if draw.random() < 0.5:
        state.add(("power",))
    objects = {"bench1": "bench"} | {place: "shelf" for place in places if place.startswith("shelf")}
    objects |= (
        dict.fromkeys(tools, "tool") | dict.fromkeys(parts, "part") | dict.fromkeys(machines, "machine")
    )
    return objects, state, {"at", "done", "mounted"}


def locks(draw: random.Random) -> World:
    rooms = [f"room{n}" for n in range(1, draw.randint(4, 5) + 1)]
    guards, state = ["ann", "bob"], set[tuple[str, ...]]()
    order = draw.sample(rooms, len(rooms))
    joined = [*itertools.pairwise(order), (order[0], order[-1])]
    doors = [f"door{n}" for n in range(1, len(joined) + 1)]
    keys = [f"key{n}" for n in range(1, len(joined) + 1)]
    for door, key, (a, b) in zip(doors, keys, joined, strict=True):
        state |= {("joins", door, a, b), ("joins", door, b, a), ("opens", key, door)}
        state.add(("lies", key, draw.choice(rooms)))
        if draw.random() < 0.3:
            state.add(("locked", door))
        if draw.random() < 0.4:
            state.add(("jammed", door))
    state |= {("in", guard, draw.choice(rooms)) for guard in guards}
    objects = dict.fromkeys(rooms, "room") | dict.fromkeys(guards, "guard")
    return (
        objects | dict.fromkeys(doors, "door") | dict.fromkeys(keys, "key"),
        state,
        {"in", "lies", "locked"},
    )


def jars(draw: random.Random) -> World:
    names = [f"jar{n}" for n in range(1, draw.randint(3, 4) + 1)]
    levels, liquids = [f"l{n}" for n in range(draw.randint(3, 4))], ["water", "oil"]
    state: set[tuple[str, ...]] = {("lowest", levels[0])}
    state |= {("next", *pair) for pair in itertools.pairwise(levels)}
    for name in names:
        state.add(("fill", name, draw.choice(levels)))
        state.add(("holds", name, draw.choice(liquids)) if draw.random() < 0.7 else ("clean", name))
        if draw.random() < 0.6:
            state.add(("open", name))
    objects = dict.fromkeys(names, "jar") | dict.fromkeys(levels, "level") | dict.fromkeys(liquids, "liquid")
    return objects, state, {"fill", "holds"}


def harbour(draw: random.Random) -> World:
    quays, yards = ["quay1", "quay2"], ["yard1", "yard2"]
    sites = [*quays, *yards, "customs"]
    vessels = {"ship1": "ship", "ship2": "ship", "barge1": "barge"}
    cranes, trucks = ["crane1", "crane2"], ["truck1", "truck2"]
    boxes = [f"box{n}" for n in range(1, draw.randint(8, 12) + 1)]
    tanks = [f"tank{n}" for n in range(1, 5)]
    state = {(word, quay) for quay in quays for word in ("free", "pump")}
    state |= {("at_sea", vessel) for vessel in vessels}
    state |= {("spare", carrier) for carrier in (*cranes, *trucks)}
    state |= {("road", *pair) for pair in itertools.permutations(sites, 2) if draw.random() < 0.7}
    for crane, quay in zip(cranes, quays, strict=True):
        state |= {("reaches", crane, quay), ("reaches", crane, draw.choice(yards))}
    state |= {("parked", truck, draw.choice(sites)) for truck in trucks}
    for box in boxes:
        at_sea = draw.random() < 0.5
        state.add(
            ("aboard", box, draw.choice(list(vessels))) if at_sea else ("stored", box, draw.choice(sites))
        )
        if draw.random() < 0.5:
            state.add(("sealed", box))
    state |= {("aboard", tank, "barge1") for tank in tanks}
    objects = dict.fromkeys(quays, "quay") | dict.fromkeys(yards, "yard") | vessels
    objects |= dict.fromkeys(cranes, "crane") | dict.fromkeys(trucks, "truck")
    objects |= dict.fromkeys(boxes, "box") | dict.fromkeys(tanks, "tank")
    return objects, state, {"stored", "cleared"}


def wiring(draw: random.Random) -> World:
    wires = [f"wire{n}" for n in range(1, draw.randint(3, 4) + 1)]
    lamps = [f"lamp{n}" for n in range(1, 5)]
    fuses = [f"fuse{n}" for n in range(1, len(wires) + 3)]
    state = {("guards", fuse, wire) for fuse, wire in zip(fuses, wires, strict=False)}
    state |= {("spare_fuse", fuse) for fuse in fuses[len(wires) :]}
    state |= {("blown" if draw.random() < 0.3 else "whole", fuse) for fuse in fuses}
    state |= {("feeds", draw.choice(wires), lamp) for lamp in lamps}
    state |= {("broken", lamp) for lamp in lamps if draw.random() < 0.4}
    objects = dict.fromkeys(wires, "wire") | dict.fromkeys(lamps, "lamp") | dict.fromkeys(fuses, "fuse")
    return objects, state, {"lit", "live", "guards"}


OWN = {"harbour": harbour, "jars": jars, "locks": locks, "wiring": wiring, "workshop": workshop}
