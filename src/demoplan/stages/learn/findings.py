"""What learning found besides operators, as a table."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from math import lgamma, log

import dataframely as dy
import numpy as np
import polars as pl

from demoplan.language.invariants import group_text
from demoplan.stages.learn.encode import Encoded
from demoplan.stages.learn.exclusion import Exclusion
from demoplan.stages.learn.lift import AFTER, BEFORE, Lifted, LiftedAtom
from demoplan.stages.learn.mend import Mended
from demoplan.stages.learn.merge import Draft
from demoplan.stages.learn.splitting import TypeSplit, find_splits
from demoplan.tables import Findings

_PER_DECADE = log(10.0)


def splits_of(data: Encoded, lifted: Lifted, drafts: Sequence[tuple[str, Draft]]) -> tuple[TypeSplit, ...]:
    """Types whose objects behave unlike, by which operator their transitions belong to."""
    outcome = np.full(len(lifted.patterns), -1, dtype=np.int64)
    for number, (_, draft) in enumerate(drafts):
        outcome[list(draft.patterns)] = number
    return find_splits(data, lifted, outcome)


def findings_of(
    mended: Mended, lifted: Lifted, drafts: Sequence[tuple[str, Draft]], splits: Sequence[TypeSplit]
) -> dy.DataFrame[Findings]:
    """Misreadings, exclusive groups, types that split, and why operators of one activity stand apart."""
    return _table(
        [
            *_misreadings(mended),
            *(_exclusion(each, mended) for each in mended.exclusions),
            *(_split(each, is_applied=False) for each in splits),
            *_variants(lifted, drafts),
        ]
    )


def with_applied(findings: dy.DataFrame[Findings], splits: Sequence[TypeSplit]) -> dy.DataFrame[Findings]:
    """Findings with the splits of types that were applied."""
    return _table([*(_split(each, is_applied=True) for each in splits), *findings.to_dicts()])


def _table(rows: Sequence[Mapping[str, object]]) -> dy.DataFrame[Findings]:
    table = pl.DataFrame(rows, schema=Findings.create_empty().schema)
    unique = table.unique(Findings.primary_key(), keep="first", maintain_order=True)
    return Findings.validate(unique.sort(Findings.primary_key()))


def _misreadings(mended: Mended) -> Iterator[dict[str, object]]:
    for code, signature in enumerate(mended.data.predicates):
        missed, imagined = float(mended.rates.missed[code]), float(mended.rates.imagined[code])
        if not mended.is_needed or not mended.n_read[code]:
            continue
        changed = int(mended.n_to_true[code] + mended.n_to_false[code])
        yield {
            "kind": "misreading",
            "subject": signature.name,
            "statement": f"{missed:.1%} of what is true is read as false, {imagined:.1%} of what is false as "
            f"true; {changed} of {int(mended.n_read[code])} readings were taken to be wrong",
            "n_support": changed,
            "n_against": int(mended.n_read[code]) - changed,
            "rate": (missed + imagined) / 2,
            "log10_bayes_factor": None,
            "is_applied": True,
        }


def _exclusion(group: Exclusion, mended: Mended) -> dict[str, object]:
    predicates, key = mended.data.predicates, mended.data.types[group.key_type]
    text = group_text(
        (predicates[code].name, position, len(predicates[code].argument_types))
        for code, position in group.members
    )
    return {
        "kind": "exclusion",
        "subject": f"{text} for # {key}",
        "statement": f"at most one of {text} holds for each {key}: {group.n_many} of {group.n_states} states "
        f"have more, where chance would give {group.expected_many:.0f}; {group.n_none} have none",
        "n_support": group.n_none + group.n_one,
        "n_against": group.n_many,
        "rate": None,
        "log10_bayes_factor": group.log_bayes_factor / _PER_DECADE,
        "is_applied": mended.is_needed,
    }


def _split(split: TypeSplit, *, is_applied: bool) -> dict[str, object]:
    verb = "moves" if split.role == "moved" else "is aimed at"
    return {
        "kind": "type",
        "subject": f"{split.type_name}: {', '.join(split.apart)}",
        "statement": f"{split.activity} goes another way where it {verb} {', '.join(split.apart)} "
        f"({split.n_apart} transitions) than where it {verb} {', '.join(split.rest)} ({split.n_rest}): "
        + (
            "the former have a type of their own"
            if is_applied
            else f"give the former a type of their own beside {split.type_name} (--split-types)"
        ),
        "n_support": split.n_apart + split.n_rest,
        "n_against": 0,
        "rate": None,
        "log10_bayes_factor": split.log_bayes_factor / _PER_DECADE,
        "is_applied": is_applied,
    }


def _variants(lifted: Lifted, drafts: Sequence[tuple[str, Draft]]) -> Iterator[dict[str, object]]:
    """Pairs of believed operators of one activity, and what tells them apart."""
    believed = [(name, draft) for name, draft in drafts if not draft.quarantine]
    for (first, one), (second, other) in combinations(believed, 2):
        if one.activity != other.activity:
            continue
        gain, unlike = _evidence_for_two(lifted, one, other)
        kinds = [
            f"{lifted.variables[place]} is {a or 'absent'} or {b or 'absent'}"
            for place, (a, b) in enumerate(zip(one.types, other.types, strict=True))
            if a != b
        ]
        differences = kinds + unlike[: 4 - min(len(kinds), 3)]
        yield {
            "kind": "variant",
            "subject": f"{first}, {second}",
            "statement": f"{first} and {second} stand apart: {'; '.join(differences) or 'in their grip'}",
            "n_support": one.count + other.count,
            "n_against": 0,
            "rate": None,
            "log10_bayes_factor": gain / _PER_DECADE,
            "is_applied": True,
        }


def _evidence_for_two(lifted: Lifted, one: Draft, other: Draft) -> tuple[float, list[str]]:
    """Logarithm of the Bayes factor of two operators against one, and the atoms that tell them apart most.

    Each value of each atom before and after is a coin: one for both operators, or one for each. Atoms over
    variables that only one of them has tell nothing.
    """
    shared = set(one.variables) & set(other.variables)
    gains: list[tuple[float, str]] = []
    sides = [_shares(lifted, draft, shared) for draft in (one, other)]
    for key in sorted(set(sides[0]) | set(sides[1])):
        (a, n), (b, m) = (
            side.get(key, (0, draft.count)) for side, draft in zip(sides, (one, other), strict=True)
        )
        gain = _log_coin(a, n - a) + _log_coin(b, m - b) - _log_coin(a + b, n - a + m - b)
        side, atom = key
        names = ",".join(lifted.variables[place] for place in atom.variables)
        when = "before" if side == BEFORE else "after"
        gains.append((gain, f"{atom.predicate}({names}) {when}: {a} of {n}, {b} of {m}"))
    gains.sort(key=lambda each: (-each[0], each[1]))
    return sum(each for each, _ in gains), [text for gain, text in gains if gain > 1.0]


def _shares(lifted: Lifted, draft: Draft, shared: set[int]) -> dict[tuple[int, LiftedAtom], tuple[int, int]]:
    found: dict[tuple[int, LiftedAtom], tuple[int, int]] = {}
    for position in draft.patterns:
        pattern = lifted.patterns[position]
        for side in (BEFORE, AFTER):
            for atom in pattern.true[side]:
                if set(atom.variables) <= shared:
                    n, _ = found.get((side, atom), (0, 0))
                    found[side, atom] = (n + pattern.count, draft.count)
    return found


def _log_coin(heads: int, tails: int) -> float:
    return lgamma(heads + 0.5) + lgamma(tails + 0.5) - lgamma(heads + tails + 1.0) - 2 * lgamma(0.5)
