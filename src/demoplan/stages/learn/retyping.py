"""Types that behaviour splits, made types of their own: in the hierarchy, in predicates, for instances.

The fewer objects get a new type beside the old one, and both stand below a new type that takes the old one's
place wherever any of them may stand. The others, and every object that nobody has seen yet, keep their type.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import dataframely as dy
import polars as pl

from demoplan.language.domains import Domain, Signature
from demoplan.language.types import ROOT, TypeHierarchy
from demoplan.stages.learn.splitting import TypeSplit
from demoplan.tables import Transitions


@dataclass(frozen=True, kw_only=True)
class Retyping:
    """A vocabulary's types and predicates after some splits, and the instances that have another type now."""

    types: TypeHierarchy
    predicates: tuple[Signature, ...]
    type_of: tuple[tuple[str, str], ...] = ()
    """Instance and its new type, sorted."""
    splits: tuple[tuple[str, tuple[str, ...]], ...] = ()
    """What was split, in order: the type, and the instances that got another one."""

    @classmethod
    def of(
        cls,
        types: TypeHierarchy,
        predicates: Sequence[Signature],
        splits: Iterable[tuple[str, Sequence[str]]] = (),
    ) -> "Retyping":
        """Types and predicates after splits, each a type and those of its instances that get another one."""
        result = cls(types=types, predicates=tuple(predicates))
        for type_name, apart in splits:
            result = result.split(type_name, apart)
        return result

    def split(self, type_name: str, apart: Sequence[str]) -> "Retyping":
        """The same with one more type.

        >>> one = Retyping.of(TypeHierarchy.of({"Toy": "object"}), []).split("Toy", ["ball"])
        >>> one.types.parents, one.type_of
        ((('AnyToy', 'object'), ('Toy', 'AnyToy'), ('Toy_2', 'AnyToy')), (('ball', 'Toy_2'),))
        """
        parents = dict(self.types.parents)
        above, whole = parents[type_name], f"Any{type_name}"
        new = next(name for n in range(2, len(parents) + 3) if (name := f"{type_name}_{n}") not in parents)
        if above != whole:
            while whole in parents:
                whole += "_"
            parents |= {whole: above, type_name: whole}
        parents[new] = whole
        return replace(
            self,
            types=TypeHierarchy.of(parents),
            predicates=tuple(
                replace(
                    each,
                    argument_types=tuple(
                        whole if kind == type_name else kind for kind in each.argument_types
                    ),
                )
                for each in self.predicates
            ),
            type_of=tuple(sorted((dict(self.type_of) | dict.fromkeys(apart, new)).items())),
            splits=(*self.splits, (type_name, tuple(apart))),
        )

    def transitions(self, transitions: dy.DataFrame[Transitions]) -> dy.DataFrame[Transitions]:
        """Transitions whose objects have their new types."""
        if not self.type_of:
            return transitions
        element, new = pl.element(), dict(self.type_of)
        name, kind = element.struct.field("name"), element.struct.field("type")
        retyped = pl.struct(
            name, name.replace_strict(new, default=kind, return_dtype=pl.String).alias("type")
        )
        return Transitions.validate(transitions.with_columns(pl.col("objects").list.eval(retyped)))

    def domain(self, domain: Domain) -> Domain:
        """A domain that says which instances are of which new type; problems take it from there."""
        return replace(
            domain, constants=tuple(sorted({**dict(domain.constants), **dict(self.type_of)}.items()))
        )


def strongest(splits: Sequence[TypeSplit]) -> tuple[TypeSplit, ...]:
    """Of each type the split with the most evidence; the root cannot be split."""
    best: dict[str, TypeSplit] = {}
    for each in splits:
        if each.type_name != ROOT:
            best.setdefault(each.type_name, each)
    return tuple(best[name] for name in sorted(best))
