"""What changed between two domains: as rows, and in words."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from demoplan.language.atoms import Literal
from demoplan.language.domains import Domain, Operator

Support: TypeAlias = Mapping[tuple[str, str, str], tuple[int, int]]
"""(operator, ``precondition`` or ``effect``, literal) → transitions that show it, and the opposite."""

ADDED, REMOVED, CHANGED = "added", "removed", "changed"


@dataclass(frozen=True, order=True)
class Change:
    """One difference. ``operator`` is empty where it concerns the domain as a whole."""

    operator: str
    """Name in the newer domain; in the older one for an operator that is gone."""
    subject: str
    """``operator``, ``name``, ``parameters``, ``precondition``, ``effect``, ``support …``, ``count``,
    ``cost``, ``type`` or ``predicate``."""
    kind: str
    """``added``, ``removed`` or ``changed``."""
    old: str = ""
    new: str = ""

    def __str__(self) -> str:
        """One sentence."""
        of = f" of {self.operator}" if self.operator and self.subject != "operator" else ""
        if self.subject == "operator":
            return f"operator {self.operator} {self.kind}: {self.new or self.old}"
        if self.kind == CHANGED:
            return f"{self.subject}{of} changed from {self.old} to {self.new}"
        return f"{self.subject}{of} {self.kind}: {self.new or self.old}"


def diff(
    old: Domain, new: Domain, old_support: Support | None = None, new_support: Support | None = None
) -> tuple[Change, ...]:
    """Every difference between two domains, in canonical order; none if they say the same.

    Operators are numbered by how often they were seen, so that a name may stand for another one in another
    version. They are therefore matched by what they say: within an activity, the most alike first.

    Args:
        old: The earlier version.
        new: The later one.
        old_support: Counts behind the earlier one's literals, if they are to be compared.
        new_support: The same of the later one.
    """
    changes: list[Change] = []
    changes += _of_sets("", "type", _type_texts(old), _type_texts(new))
    changes += _of_sets("", "predicate", _predicate_texts(old), _predicate_texts(new))
    pairs = _matched(old.operators, new.operators)
    for before, after in pairs:
        changes += _of_operator(before, after)
        if old_support is not None and new_support is not None:
            changes += _of_support(before, after, old_support, new_support)
    known_old = {before.name for before, _ in pairs}
    known_new = {after.name for _, after in pairs}
    changes += [
        Change(each.name, "operator", REMOVED, old=_summary(each))
        for each in old.operators
        if each.name not in known_old
    ]
    changes += [
        Change(each.name, "operator", ADDED, new=_summary(each))
        for each in new.operators
        if each.name not in known_new
    ]
    return tuple(sorted(changes))


def in_words(changes: Sequence[Change]) -> str:
    """The changes as text, one sentence to a line.

    >>> in_words([])
    'no difference'
    """
    return "\n".join(str(change) for change in changes) or "no difference"


def _type_texts(domain: Domain) -> set[str]:
    return {f"{name} < {parent}" for name, parent in domain.types.parents}


def _predicate_texts(domain: Domain) -> set[str]:
    return {f"{each.name}({', '.join(each.argument_types)})" for each in domain.predicates}


def _summary(operator: Operator) -> str:
    parameters = ", ".join(f"{each.variable} {each.type_name}" for each in operator.parameters)
    effects = " & ".join(str(each) for each in sorted(operator.effects))
    return f"({parameters}) gives {effects or 'nothing'}; seen {operator.count} times"


def _content(operator: Operator) -> frozenset[tuple[str, object]]:
    return frozenset(
        [("parameter", each) for each in operator.parameters]
        + [("precondition", each) for each in operator.preconditions]
        + [("effect", each) for each in operator.effects]
    )


def _likeness(one: Operator, other: Operator) -> float:
    """Share of parameters and literals that two operators have in common (Jaccard index)."""
    first, second = _content(one), _content(other)
    return len(first & second) / max(len(first | second), 1)


def _matched(old: Sequence[Operator], new: Sequence[Operator]) -> list[tuple[Operator, Operator]]:
    candidates = sorted(
        (
            (-_likeness(before, after), before.name != after.name, before.name, after.name, before, after)
            for before in old
            for after in new
            if before.activity == after.activity and _content(before) & _content(after)
        ),
        key=lambda each: each[:4],
    )
    pairs: list[tuple[Operator, Operator]] = []
    taken: set[tuple[str, str]] = set()
    for *_, before, after in candidates:
        keys = {("old", before.name), ("new", after.name)}
        if not keys & taken:
            pairs.append((before, after))
            taken |= keys
    return pairs


def _of_operator(old: Operator, new: Operator) -> list[Change]:
    changes: list[Change] = []
    parameters = tuple(
        ", ".join(f"{p.variable} {p.type_name}" for p in each.parameters) for each in (old, new)
    )
    for subject, before, after in (
        ("name", old.name, new.name),
        ("parameters", *parameters),
        ("count", str(old.count), str(new.count)),
        ("cost", str(old.cost), str(new.cost)),
    ):
        if before != after:
            changes.append(Change(new.name, subject, CHANGED, before, after))
    changes += _of_sets(new.name, "precondition", _texts(old.preconditions), _texts(new.preconditions))
    changes += _of_sets(new.name, "effect", _texts(old.effects), _texts(new.effects))
    return changes


def _of_support(old: Operator, new: Operator, old_support: Support, new_support: Support) -> list[Change]:
    changes = []
    for role, stated in (
        ("precondition", old.preconditions & new.preconditions),
        ("effect", old.effects & new.effects),
    ):
        for literal in sorted(stated):
            before = old_support.get((old.name, role, str(literal)), (0, 0))
            after = new_support.get((new.name, role, str(literal)), (0, 0))
            if before != after:
                texts = (f"{right} for, {wrong} against" for right, wrong in (before, after))
                changes.append(Change(new.name, f"support of {role} {literal}", CHANGED, *texts))
    return changes


def _texts(literals: Iterable[Literal]) -> set[str]:
    return {str(literal) for literal in literals}


def _of_sets(operator: str, subject: str, old: set[str], new: set[str]) -> list[Change]:
    removed = [Change(operator, subject, REMOVED, old=text) for text in sorted(old - new)]
    return removed + [Change(operator, subject, ADDED, new=text) for text in sorted(new - old)]
