"""Time and memory of learning against the number of traces: blocksworld walks with flips, as text and all.

``python benchmarks/learners/scale.py --work FOLDER --traces 10,100,1000,10000 --length 100``
"""

import argparse
import itertools
import random
import resource
import time
from pathlib import Path

from demoplan.language.traces import TraceReader, read_signatures
from demoplan.stages.denoise import conclude, gather

BLOCKS = [f"b{n}" for n in range(1, 7)]
DOMAIN = """(define (domain blocksworld) (:requirements :strips :typing) (:types block)
(:predicates (on ?x - block ?y - block) (ontable ?x - block) (clear ?x - block) (handempty)
(holding ?x - block))
(:action pick_up :parameters (?x - block)) (:action put_down :parameters (?x - block))
(:action stack :parameters (?x - block ?y - block)) (:action unstack :parameters (?x - block ?y - block)))"""
ATOMS = (
    ["handempty"]
    + [f"{name} {block}" for name in ("ontable", "clear", "holding") for block in BLOCKS]
    + [f"on {a} {b}" for a, b in itertools.product(BLOCKS, repeat=2)]
)


def walk(length: int, rate: float, draw: random.Random) -> str:
    """One random walk, every atom of every state flipped with the same probability."""
    under: dict[str, str] = dict.fromkeys(BLOCKS, "table")
    held = ""
    parts = ["(:trajectory"]
    for step in range(length + 1):
        tops = [block for block in BLOCKS if block != held and block not in under.values()]
        state = {f"ontable {b}" if u == "table" else f"on {b} {u}" for b, u in under.items()}
        state |= {f"clear {block}" for block in tops} | {f"holding {held}" if held else "handempty"}
        state ^= {atom for atom in ATOMS if draw.random() < rate} if rate else set()
        parts.append("(:state (" + ") (".join(sorted(state)) + "))")
        if step == length:
            break
        if held:
            choice = draw.choice([*tops, "table"])
            parts.append(
                f"(:action (put_down {held}))" if choice == "table" else f"(:action (stack {held} {choice}))"
            )
            under[held], held = choice, ""
        else:
            held = draw.choice(tops)
            was = under.pop(held)
            parts.append(
                f"(:action (pick_up {held}))" if was == "table" else f"(:action (unstack {held} {was}))"
            )
    return "\n".join(parts) + "\n)\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--traces", default="10,100,1000")
    parser.add_argument("--length", type=int, default=100)
    parser.add_argument("--pending", type=int, default=2_000_000, help="atoms read before they are counted")
    parser.add_argument("--rate", type=float, default=0.05)
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    objects = dict.fromkeys(BLOCKS, "block")
    print("| traces | transitions | MB of text | read and count s | learn s | peak MB | literals wrong |")
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for n in map(int, args.traces.split(",")):
        folder = args.work / f"walks-{args.length}-{args.rate}"
        folder.mkdir(exist_ok=True)
        for index in range(n):
            path = folder / f"{index}_traj"
            if not path.exists():
                path.write_text(walk(args.length, args.rate, random.Random(index)))
        start = time.perf_counter()
        signatures, _ = read_signatures(DOMAIN, "domain.pddl")
        reader, gathered, size = TraceReader(signatures), None, 0
        for index in range(n):
            text = (folder / f"{index}_traj").read_text()
            size += len(text)
            reader.add(text, f"{index}_traj", objects)
            if reader.n_pending > args.pending:
                gathered = gather(reader.take(), so_far=gathered)
        gathered = gather(reader.take(), so_far=gathered)
        middle = time.perf_counter()
        learned = conclude(gathered).actions()
        end = time.perf_counter()
        n_transitions = int(gathered.counts.n_transitions.sum())
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        row = (
            n,
            n_transitions,
            f"{size / 1e6:.0f}",
            f"{middle - start:.2f}",
            f"{end - middle:.2f}",
            f"{peak:.0f}",
        )
        print("| " + " | ".join(map(str, (*row, _n_wrong(learned)))) + " |", flush=True)


def _n_wrong(learned: dict) -> int:
    true = {
        "pick_up": "clear(?x) ontable(?x) handempty() | -ontable(?x) -clear(?x) -handempty() holding(?x)",
        "put_down": "holding(?x) | -holding(?x) clear(?x) handempty() ontable(?x)",
        "stack": "holding(?x) clear(?y) | -holding(?x) -clear(?y) clear(?x) handempty() on(?x,?y)",
        "unstack": "on(?x,?y) clear(?x) handempty()"
        " | holding(?x) clear(?y) -clear(?x) -handempty() -on(?x,?y)",
    }
    wrong = 0
    for name, text in true.items():
        for wanted, found in zip(text.split("|"), learned.get(name, ((), ())), strict=True):
            said = {("" if each.is_positive else "-") + str(each.atom) for each in found}
            wrong += len(said ^ set(wanted.split()))
    return wrong


main()
