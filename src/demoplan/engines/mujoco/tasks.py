"""What is to be demonstrated: which cube goes on to what, with which hand."""

import re
from dataclasses import dataclass

from demoplan.engines.mujoco.scene import COLOURS, TABLE, cube_names
from demoplan.errors import UnknownNameError, UsageError

HANDS = {"left": "Left_hand", "right": "Right_hand"}


@dataclass(frozen=True)
class Step:
    """Put one cube on to another, or on the table, with one hand."""

    cube: str
    onto: str
    hand: str


@dataclass(frozen=True)
class Task:
    """Steps in order, and what is stacked before they begin."""

    name: str
    steps: tuple[Step, ...]
    start: tuple[tuple[str, str], ...] = ()
    """(cube, cube below it) pairs."""
    n_cubes: int = 4

    @property
    def hand(self) -> str | None:
        """The hand that acts, if only one does."""
        hands = {step.hand for step in self.steps}
        return hands.pop() if len(hands) == 1 else None

    @property
    def goal(self) -> tuple[tuple[str, str], ...]:
        """(cube, support) pairs that must hold in the end: where each moved cube was put last."""
        return tuple(sorted({step.cube: step.onto for step in self.steps}.items()))

    @property
    def goal_text(self) -> str:
        """The goal, as goal text."""
        return " & ".join(f"onTop({cube}, {support})" for cube, support in self.goal)


_R, _B, _G, _Y = (f"cube_{colour}" for colour in ("red", "blue", "green", "yellow"))

_NAMED: dict[str, tuple[tuple[tuple[str, str], ...], tuple[tuple[str, str], ...], int]] = {
    "one": (((_R, _B),), (), 4),
    "two": (((_R, _B), (_G, _R)), (), 4),
    "reordered": (((_G, _Y), (_B, _G)), (), 4),
    "two-towers": (((_R, _B), (_G, _Y)), (), 4),
    "unstack": (((_R, TABLE),), ((_R, _B),), 4),
    "put-back": (((_G, TABLE), (_R, TABLE)), ((_R, _B), (_G, _R)), 4),
    "rebuild": (((_R, TABLE), (_B, _R)), ((_R, _B),), 4),
    "five": (((_R, _B), (_G, _R), (_Y, _G)), (), 5),
}

STUDY_TASKS = ("one-left", "one-right", "two-left", "two-right")
"""The four combinations of the study: one and two cubes stacked, with either hand."""

_STEP = re.compile(r"\s*(\w+)\s*>\s*(\w+)\s*(?:@\s*(left|right))?\s*")


def _thing(word: str) -> str:
    if word == TABLE:
        return TABLE
    colour = word.removeprefix("cube_")
    if colour not in COLOURS:
        raise UnknownNameError("cube", word, (*COLOURS, TABLE), "a task")
    return f"cube_{colour}"


def parse_task(text: str) -> Task:
    """The task that a text names or spells out.

    A name is ``<what>-<hand>``, as in ``two-left``. Spelled out: ``name: red>blue, green>red@left; start
    yellow>orange; cubes 5`` puts red on blue with the right hand, then green on red with the left one.

    >>> parse_task("one-left").goal_text
    'onTop(cube_red, cube_blue)'
    >>> parse_task("mine: red>table@left; start red>blue").steps[0].hand
    'Left_hand'

    Raises:
        UnknownNameError: If the name, a hand or a cube is unknown.
        UsageError: If the text is not a task, or asks for what cannot be done.
    """
    if ":" not in text:
        what, _, side = text.rpartition("-")
        if what not in _NAMED or side not in HANDS:
            raise UnknownNameError("task", text, (f"{name}-{hand}" for name in _NAMED for hand in HANDS))
        moves, stacked, n_cubes = _NAMED[what]
        return Task(text, tuple(Step(cube, onto, HANDS[side]) for cube, onto in moves), stacked, n_cubes)
    name, _, rest = text.partition(":")
    name = name.strip()
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_-]{0,60}", name):
        raise UsageError(f"task name {name!r}: give letters, digits, '-' and '_', at most 61")
    first, *clauses = rest.split(";")
    steps = tuple(
        Step(cube, onto, HANDS[side or "right"]) for cube, onto, side in map(_move, first.split(","))
    )
    start: tuple[tuple[str, str], ...] = ()
    n_cubes = 4
    for clause in clauses:
        word, _, value = clause.strip().partition(" ")
        if word == "start":
            start = tuple((cube, onto) for cube, onto, _ in map(_move, value.split(",")))
        elif word == "cubes" and value.strip().isdigit():
            n_cubes = int(value)
        else:
            raise UsageError(f"task {name!r}: clause {clause.strip()!r}; allowed: 'start a>b, …', 'cubes N'")
    present = cube_names(n_cubes)
    for thing in (
        {step.cube for step in steps} | {step.onto for step in steps} | {c for p in start for c in p}
    ):
        if thing != TABLE and thing not in present:
            raise UnknownNameError("cube", thing, present, f"task {name!r} with {n_cubes} cubes")
    _refuse_impossible(name, start, steps)
    return Task(name, steps, start, n_cubes)


def _refuse_impossible(name: str, start: tuple[tuple[str, str], ...], steps: tuple[Step, ...]) -> None:
    """Only what nothing stands on can be taken, or be put on: a task that asks for more is a mistake."""
    covered_by: dict[str, str] = {}
    for cube, onto in start:
        if onto != TABLE and onto in covered_by:
            raise UsageError(f"task {name!r}: at the start {covered_by[onto]} and {cube} are both on {onto}")
        covered_by[onto] = cube
    covered_by.pop(TABLE, None)
    for step in steps:
        for thing in (step.cube, step.onto):
            if thing in covered_by:
                raise UsageError(
                    f"task {name!r}: {step.cube} cannot go on to {step.onto} "
                    f"while {covered_by[thing]} is on {thing}"
                )
        covered_by = {below: cube for below, cube in covered_by.items() if cube != step.cube}
        if step.onto != TABLE:
            covered_by[step.onto] = step.cube


def _move(text: str) -> tuple[str, str, str | None]:
    match = _STEP.fullmatch(text)
    if match is None:
        raise UsageError(f"not a move: {text.strip()!r}; give cube>onto, or cube>onto@left")
    cube, onto = _thing(match[1]), _thing(match[2])
    if cube in (TABLE, onto):
        raise UsageError(f"not a move: {text.strip()!r}; a cube goes on to another cube or the table")
    return cube, onto, match[3]
