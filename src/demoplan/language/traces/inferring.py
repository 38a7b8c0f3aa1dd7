"""Signatures from traces alone: predicates and actions by their use, types by the places objects share."""

import re
from collections.abc import Iterable

from demoplan.language.domains import Parameter, Signature
from demoplan.language.traces.values import ActionSignature, Fault, Signatures
from demoplan.language.types import TypeHierarchy

_LIST = re.compile(r"\(\s*(:action|:operator|operator:)?\s*(?:\(\s*)?([^\s():][^()]*)\)", re.IGNORECASE)

Place = tuple[str, str, int]
"""Kind (predicate or action), name, and which argument."""


class _Groups:
    """Places that must have one type, merged as objects are found in them."""

    def __init__(self) -> None:
        self.parent: dict[Place, Place] = {}

    def find(self, place: Place) -> Place:
        self.parent.setdefault(place, place)
        root = place
        while self.parent[root] != root:
            root = self.parent[root]
        while self.parent[place] != root:
            self.parent[place], place = root, self.parent[place]
        return root

    def merge(self, one: Place, other: Place) -> None:
        low, high = sorted((self.find(one), self.find(other)))
        self.parent[high] = low


def infer_signatures(traces: Iterable[tuple[str, str]]) -> tuple[Signatures, tuple[Fault, ...]]:
    """Predicates, actions and types that traces show.

    Two argument places have the same type if one object of one trace was found in both.

    Args:
        traces: Text and file name of each trace.

    Returns:
        Signatures with types ``type-1``, ``type-2`` …, and uses whose number of arguments contradicts the
        first.
    """
    arities: dict[tuple[str, str], int] = {}
    groups = _Groups()
    faults: dict[tuple[str, str], Fault] = {}
    for text, file in traces:
        first_place: dict[str, Place] = {}
        for match in _LIST.finditer(text):
            kind = "action" if match[1] else "predicate"
            name, *objects = match[2].lower().split()
            if name in {"and", "not"}:
                continue
            if arities.setdefault((kind, name), len(objects)) != len(objects):
                problem = (
                    f"{kind} {name!r} with {len(objects)} arguments; elsewhere it has {arities[kind, name]}"
                )
                line = text.count("\n", 0, match.start()) + 1
                faults.setdefault((file, problem), Fault(file, line, problem))
                continue
            for position, each in enumerate(objects):
                place = (kind, name, position)
                groups.merge(place, first_place.setdefault(each, place))
    roots = sorted({groups.find(place) for place in groups.parent})
    names = {root: f"type-{n}" for n, root in enumerate(roots, start=1)}

    def types_of(kind: str, name: str) -> tuple[str, ...]:
        return tuple(names[groups.find((kind, name, position))] for position in range(arities[kind, name]))

    predicates = [
        Signature(name, types_of(kind, name)) for kind, name in sorted(arities) if kind == "predicate"
    ]
    actions = [
        ActionSignature(
            name, tuple(Parameter(f"?x{n}", each) for n, each in enumerate(types_of(kind, name), start=1))
        )
        for kind, name in sorted(arities)
        if kind == "action"
    ]
    types = TypeHierarchy.of(dict.fromkeys(names.values(), "object"))
    signatures = Signatures("learned", types, (), tuple(predicates), tuple(actions))
    return signatures, tuple(sorted(faults.values()))
