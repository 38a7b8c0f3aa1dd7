"""Lifted patterns to operators: which belong together, over which types, with which counts."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import TypeAlias

import numpy as np

from demoplan.inference import ADD, DELETE, FALSE, TRUE, UNSEEN, BeliefParams, believe_pairs
from demoplan.language.domains import Signature
from demoplan.language.types import TypeHierarchy
from demoplan.stages.learn.lift import AFTER, BEFORE, Lifted, LiftedAtom, Pattern
from demoplan.stages.learn.params import LearnParams


@dataclass(frozen=True, kw_only=True)
class Candidate:
    """A literal that was considered for an operator, with what speaks for and against it."""

    atom: LiftedAtom
    is_positive: bool
    n_support: int
    n_against: int
    probability: float
    is_kept: bool
    note: str | None = None


@dataclass(frozen=True, kw_only=True)
class Draft:
    """An operator in the making."""

    activity: str
    grip: str
    types: tuple[str | None, ...]
    """Type of each variable; null where the operator does not have it."""
    patterns: tuple[int, ...]
    count: int
    preconditions: tuple[Candidate, ...] = ()
    effects: tuple[Candidate, ...] = ()
    quarantine: str | None = None
    """Why it is left out of the domain."""
    note: str | None = field(default=None)
    parted_by: tuple[tuple[LiftedAtom, bool], ...] = ()
    """Conditions, with their value, that tell it apart from another of the same activity."""

    @property
    def variables(self) -> tuple[int, ...]:
        """Positions of the variables that it has."""
        return tuple(position for position, name in enumerate(self.types) if name is not None)

    def kept(self, role: str) -> frozenset[tuple[LiftedAtom, bool]]:
        """Stated literals of ``precondition`` or ``effect``."""
        candidates = self.preconditions if role == "precondition" else self.effects
        return frozenset((each.atom, each.is_positive) for each in candidates if each.is_kept)


def covering_types(seen: Iterable[str], types: TypeHierarchy) -> dict[str, str]:
    """For each type seen, the highest ancestor all of whose kinds were seen.

    A type is covered if it was seen itself or if all its direct subtypes are covered.

    >>> types = TypeHierarchy.of({"Cube": "Solid", "Ball": "Solid", "Solid": "object", "Hand": "object"})
    >>> covering_types(["Cube", "Ball"], types), covering_types(["Cube"], types)
    ({'Ball': 'Solid', 'Cube': 'Solid'}, {'Cube': 'Cube'})
    """
    names = frozenset(seen)
    covered: dict[str, bool] = {}

    def is_covered(name: str) -> bool:
        if name not in covered:
            children = types.children(name)
            covered[name] = name in names or (bool(children) and all(is_covered(child) for child in children))
        return covered[name]

    lifted = {}
    for name in sorted(names):
        highest = name
        for ancestor in types.ancestors(name):
            if not is_covered(ancestor):
                break
            highest = ancestor
        lifted[name] = highest
    return lifted


def merge(
    lifted: Lifted,
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    params: LearnParams,
    relevance: "Relevance",
    misread_rate: float = 0.0,
) -> list[Draft]:
    """Group patterns that change hold and support alike, lift their types, and weigh every literal."""
    groups: dict[tuple[object, ...], list[int]] = defaultdict(list)
    for position, pattern in enumerate(lifted.patterns):
        if pattern.is_uneventful:
            continue
        mask = tuple(name is not None for name in pattern.types)
        groups[pattern.activity, pattern.grip, mask].append(position)
    drafts = []
    for key in sorted(groups, key=repr):
        for names, members in _split_by_type(groups[key], lifted.patterns, types):
            first = lifted.patterns[members[0]]
            drafts.append(
                Draft(
                    activity=first.activity,
                    grip=first.grip,
                    types=names,
                    patterns=tuple(members),
                    count=sum(lifted.patterns[position].count for position in members),
                )
            )
    return weigh(
        drafts,
        lifted.patterns,
        types,
        predicates,
        params=params,
        relevance=relevance,
        misread_rate=misread_rate,
    )


def _split_by_type(
    members: Sequence[int], patterns: Sequence[Pattern], types: TypeHierarchy
) -> list[tuple[tuple[str | None, ...], list[int]]]:
    columns = zip(*(patterns[position].types for position in members), strict=True)
    covers = [covering_types({name for name in column if name is not None}, types) for column in columns]
    split: dict[tuple[str | None, ...], list[int]] = defaultdict(list)
    for position in members:
        names = tuple(
            None if name is None else cover[name]
            for name, cover in zip(patterns[position].types, covers, strict=True)
        )
        split[names].append(position)
    return sorted(split.items(), key=repr)


@dataclass(frozen=True, kw_only=True)
class Relevance:
    """Which literals may be stated at all; the positions of variables are those of the lifted atoms."""

    is_effect: Callable[[LiftedAtom], bool]
    """Whether an atom's change may be an effect."""
    is_link: Callable[[LiftedAtom], bool]
    """Whether an atom is a state of the hand by which activities follow each other: one brings it about, the
    next takes away. Such atoms change at the ends of activities, which are never exact, so that exceptions
    are many; the majority decides."""
    is_condition: Callable[[LiftedAtom, bool, bool], bool]
    """Whether a literal (atom, is_positive, is_changed) may be a precondition."""


def universe(
    names: Sequence[str | None], types: TypeHierarchy, predicates: Sequence[Signature]
) -> list[LiftedAtom]:
    """Every atom over the variables that their types allow, each variable at most once, sorted."""
    atoms = []
    for signature in predicates:
        places = [
            [
                position
                for position, name in enumerate(names)
                if name is not None and types.is_subtype(name, wanted)
            ]
            for wanted in signature.argument_types
        ]
        atoms += [
            LiftedAtom(signature.name, chosen)
            for chosen in product(*places)
            if len(set(chosen)) == len(chosen)
        ]
    return sorted(atoms)


Cells: TypeAlias = Counter[tuple[bool | None, bool | None]]
"""Transitions by an atom's value (null: not observed) before and after."""


@dataclass(frozen=True)
class Belief:
    """What a literal's atom likely is to its operator, from counts of its values before and after."""

    required: float
    """Probability that the atom is always true before."""
    avoided: float
    """Probability that it is always false before."""
    added: float
    deleted: float


_LEFT = 0.2
"""Share of misreadings that mending leaves, or makes; see ``benchmarks/learning.py``."""


def believed(
    cells_of: Sequence[tuple[LiftedAtom, Cells]],
    predicates: Sequence[Signature],
    params: LearnParams,
    misread_rate: float = 0.0,
) -> list[Belief]:
    """Beliefs about the atoms of operators, all at once: predicates share rates and habits."""
    code_of = {signature.name: code for code, signature in enumerate(predicates)}
    counts = np.zeros((len(cells_of), 3, 3), dtype=np.int64)
    index = {None: UNSEEN, False: FALSE, True: TRUE}
    for row, (_, cells) in enumerate(cells_of):
        for (before, after), count in cells.items():
            counts[row, index[before], index[after]] += count
    predicate = np.array([code_of[atom.predicate] for atom, _ in cells_of], dtype=np.int64)
    if not len(predicate):
        return []
    least = max(BeliefParams.flip_min, _LEFT * misread_rate)
    found = believe_pairs(counts, predicate, len(predicates), BeliefParams(slip=params.slip, flip_min=least))
    return [
        Belief(
            required=min(float(found.required[row]), 1.0),
            avoided=min(float(found.avoided[row]), 1.0),
            added=min(float(found.effects[row, ADD]), 1.0),
            deleted=min(float(found.effects[row, DELETE]), 1.0),
        )
        for row in range(len(predicate))
    ]


def weigh(
    drafts: Sequence[Draft],
    patterns: Sequence[Pattern],
    types: TypeHierarchy,
    predicates: Sequence[Signature],
    *,
    params: LearnParams,
    relevance: Relevance,
    misread_rate: float = 0.0,
) -> list[Draft]:
    """The drafts with every relevant literal's counts, posterior, and whether it is stated."""
    cells_of = [
        (position, atom, _cells(atom, [patterns[each] for each in draft.patterns]))
        for position, draft in enumerate(drafts)
        for atom in universe(draft.types, types, predicates)
    ]
    beliefs = believed([(atom, cells) for _, atom, cells in cells_of], predicates, params, misread_rate)
    effects: list[list[Candidate]] = [[] for _ in drafts]
    conditions: list[list[Candidate]] = [[] for _ in drafts]
    for (position, atom, cells), belief in zip(cells_of, beliefs, strict=True):
        condition, changes = _literals(atom, cells, belief, params=params, relevance=relevance)
        forced = dict(drafts[position].parted_by).get(atom)
        if forced is not None:
            condition = [_parting(atom, forced, cells, belief)]
        conditions[position] += condition
        effects[position] += changes
    return [
        replace(draft, preconditions=tuple(before), effects=tuple(after))
        for draft, before, after in zip(drafts, conditions, effects, strict=True)
    ]


def _parting(atom: LiftedAtom, value: bool, cells: Cells, belief: Belief) -> Candidate:
    """The condition that an operator was parted by: all its transitions show it."""
    return Candidate(
        atom=atom,
        is_positive=value,
        n_support=sum(count for (before, _), count in cells.items() if before is value),
        n_against=sum(count for (before, _), count in cells.items() if before is (not value)),
        probability=belief.required if value else belief.avoided,
        is_kept=True,
        note="tells the operator apart from another of its activity",
    )


def _literals(
    atom: LiftedAtom, cells: Cells, belief: Belief, *, params: LearnParams, relevance: Relevance
) -> tuple[list[Candidate], list[Candidate]]:
    """What an atom is to an operator: at most one condition, and the effects that were considered."""
    made = {
        value: _effect(atom, value, cells, belief, params=params, relevance=relevance)
        for value in (True, False)
    }
    stated = [each for each in made.values() if each is not None and each.is_kept]
    if len(stated) > 1:
        best = max(stated, key=lambda each: (each.probability, each.is_positive))
        made = {value: each if each is best else None for value, each in made.items()}
    condition = _condition(atom, cells, made, belief, params=params, relevance=relevance)
    effects = []
    for each in made.values():
        if each is None:
            continue
        holds = condition is not None and condition.is_kept and condition.is_positive == each.is_positive
        effects.append(
            replace(each, is_kept=False, note="holds already, by a precondition")
            if holds and each.is_kept
            else each
        )
    return [] if condition is None else [condition], effects


_LINK = "kept by majority against the count: it links activities, whose ends are never exact"


def _cells(atom: LiftedAtom, members: Sequence[Pattern]) -> Cells:
    cells: Cells = Counter()
    for pattern in members:
        value = tuple(
            None if atom in pattern.unknown[side] else atom in pattern.true[side] for side in (BEFORE, AFTER)
        )
        cells[value[0], value[1]] += pattern.count
    return cells


def _effect(
    atom: LiftedAtom,
    value: bool,
    cells: Cells,
    belief: Belief,
    *,
    params: LearnParams,
    relevance: Relevance,
) -> Candidate | None:
    n_made = cells[not value, value]
    if not n_made or not relevance.is_effect(atom):
        return None
    support = sum(count for (_, after), count in cells.items() if after is value)
    against = sum(count for (_, after), count in cells.items() if after is not value and after is not None)
    probability = belief.added if value else belief.deleted
    is_kept = probability >= params.min_probability
    note = None if is_kept else "counts speak for chance or for no change"
    n_known = support + against
    is_usual = support > against and n_made > max(cells[not value, not value], n_known / 4)
    if not is_kept and is_usual and relevance.is_link(atom):
        is_kept, note = True, _LINK
    return Candidate(
        atom=atom,
        is_positive=value,
        n_support=support,
        n_against=against,
        probability=probability,
        is_kept=is_kept,
        note=note,
    )


def _condition(
    atom: LiftedAtom,
    cells: Cells,
    made: dict[bool, Candidate | None],
    belief: Belief,
    *,
    params: LearnParams,
    relevance: Relevance,
) -> Candidate | None:
    held = sum(count for (before, _), count in cells.items() if before is True)
    absent = sum(count for (before, _), count in cells.items() if before is False)
    if held + absent == 0:
        return None
    value = held >= absent
    if held == absent:
        # As often as not: what the operator changes it from.
        made_true = made[True]
        value = made_true is None or not made_true.is_kept
    opposite = made[not value]
    is_changed = opposite is not None and opposite.is_kept
    if not relevance.is_condition(atom, value, is_changed):
        return None
    support, against = (held, absent) if value else (absent, held)
    probability = belief.required if value else belief.avoided
    is_kept = probability >= params.min_probability
    note = None if is_kept else "holds too irregularly to be a condition"
    if is_changed and support > against and relevance.is_link(atom):
        # A hand goes from one state to the next: without the former, steps could be done in advance.
        is_kept, note = True, None if is_kept else _LINK
    elif is_changed and is_kept and not value:
        # The operator makes it true whatever was before: asking for its absence would only forbid plans.
        is_kept, note = False, "the operator itself makes the opposite true"
    return Candidate(
        atom=atom,
        is_positive=value,
        n_support=support,
        n_against=against,
        probability=probability,
        is_kept=is_kept,
        note=note,
    )
