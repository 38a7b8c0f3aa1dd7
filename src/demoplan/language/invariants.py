"""What an object can only be in one of: sets of atoms of which at most one holds for each object.

A cube is on one thing; a hand is open or holds one thing. Operators themselves say so: whatever adds such an
atom takes away the one that held before.

Source: M. Helmert, "Concise finite-domain representations for PDDL planning tasks", Artificial Intelligence
173, 2009, doi:10.1016/j.artint.2008.10.013, section 5, for groups of one or two predicates and one key,
without refinement.
"""

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations

from demoplan.language.atoms import Atom
from demoplan.language.domains import Domain, Operator


@dataclass(frozen=True, order=True)
class ExclusiveGroup:
    """Of all atoms with one object in the place of the key, at most one holds.

    ``members`` holds (predicate, position of the key) pairs, sorted.
    """

    members: tuple[tuple[str, int], ...]

    def key(self, atom: Atom) -> str | None:
        """The object that an atom of the group is about, or None for an atom outside of it."""
        for predicate, position in self.members:
            if predicate == atom.predicate:
                return atom.arguments[position]
        return None


_MEMBER = re.compile(r"([A-Za-z][\w-]*)\(([#·,]*)\)")


def group_text(members: Iterable[tuple[str, int, int]]) -> str:
    """A group as text, the object's place marked, from (predicate, position, number of arguments).

    >>> group_text([("handOpen", 0, 1), ("inHand", 0, 2)])
    'handOpen(#), inHand(#,·)'
    """
    return ", ".join(
        f"{name}({','.join('#' if place == position else '·' for place in range(n))})"
        for name, position, n in members
    )


def parse_group(text: str) -> ExclusiveGroup:
    """The group that a text of :func:`group_text` stands for.

    >>> parse_group("handOpen(#), inHand(#,·)")
    ExclusiveGroup(members=(('handOpen', 0), ('inHand', 0)))
    """
    members = [(match[1], match[2].split(",").index("#")) for match in _MEMBER.finditer(text)]
    return ExclusiveGroup(tuple(sorted(members)))


def exclusive_groups(domain: Domain, state: Iterable[Atom] = ()) -> tuple[ExclusiveGroup, ...]:
    """Groups that every operator keeps exclusive, and that a state does not break, sorted.

    Predicates that nothing adds are in no group: nothing is known of them.

    Args:
        domain: Operators that speak for or against a group.
        state: Atoms that hold at some time, as the start of a problem.
    """
    atoms = list(state)
    places = [
        (signature.name, position)
        for signature in domain.predicates
        for position in range(len(signature.argument_types))
    ]
    candidates = [ExclusiveGroup((place,)) for place in places]
    candidates += [
        ExclusiveGroup(tuple(sorted(pair))) for pair in combinations(places, 2) if pair[0][0] != pair[1][0]
    ]
    added = {
        effect.atom.predicate for each in domain.operators for effect in each.effects if effect.is_positive
    }
    return tuple(
        sorted(
            group
            for group in candidates
            if all(predicate in added for predicate, _ in group.members)
            and all(_keeps(operator, group) for operator in domain.operators)
            and max(Counter(group.key(atom) for atom in atoms if group.key(atom)).values(), default=0) <= 1
        )
    )


def _keeps(operator: Operator, group: ExclusiveGroup) -> bool:
    """Whether an operator adds at most one atom of the group, and only in exchange for another."""
    added = [each.atom for each in operator.effects if each.is_positive and group.key(each.atom) is not None]
    if len(added) > 1:
        return False
    return all(
        any(
            not each.is_positive
            and each.atom != atom
            and group.key(each.atom) == group.key(atom)
            and each.negated() in operator.preconditions
            for each in operator.effects
        )
        for atom in added
    )
