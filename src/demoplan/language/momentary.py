"""Which predicates only describe a motion in progress, and what operators say beside them.

An operator that was learned from watching states everything that was so around a transition: also that the
hand was moving, and where to. Such inputs of a classifier last as long as the motion does. A planner may
chain them, since they tell in which order activities follow. Nobody can demand them of a world that stands still
between two motions, or plan from them after one has failed: there only what lasts counts.
"""

from dataclasses import dataclass, replace

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator
from demoplan.language.execution import GroundOperator, State
from demoplan.language.types import ROOT, TypeHierarchy


@dataclass(frozen=True, kw_only=True)
class Momentary:
    """The declared property: these predicates tell of motions; all others last until something ends them."""

    predicates: tuple[str, ...] = ("actedOn", "handMove")
    """Whatever their arguments are."""
    towards: tuple[tuple[str, str], ...] = (("inTouch", "Hand"),)
    """(predicate, type): only where one of the arguments is of the type. That a cube touches a hand is over
    when the hand opens; that it touches another cube lasts."""

    def is_momentary(self, atom: Atom, type_of: dict[str, str], types: TypeHierarchy) -> bool:
        """Whether an atom tells of a motion.

        Args:
            atom: Ground or lifted.
            type_of: Type of each of its arguments, by name.
            types: The hierarchy that the types belong to.
        """
        if atom.predicate in self.predicates:
            return True
        return any(
            atom.predicate == predicate
            and any(
                types.is_subtype(type_of.get(name, ROOT), wanted) if wanted in types.names else False
                for name in atom.arguments
            )
            for predicate, wanted in self.towards
        )

    def lasting_state(self, state: State, type_of: dict[str, str], types: TypeHierarchy) -> State:
        """The atoms of a state that last."""
        return frozenset(atom for atom in state if not self.is_momentary(atom, type_of, types))

    def lasting_step(
        self, step: GroundOperator, type_of: dict[str, str], types: TypeHierarchy
    ) -> GroundOperator:
        """What can be demanded of the world before a step, and expected of it afterwards."""
        return replace(
            step,
            preconditions=frozenset(
                literal
                for literal in step.preconditions
                if not self.is_momentary(literal.atom, type_of, types)
            ),
            adds=self.lasting_state(step.adds, type_of, types),
            deletes=self.lasting_state(step.deletes, type_of, types),
        )

    def lasting_domain(self, domain: Domain) -> Domain:
        """The domain without momentary conditions and effects, to plan from a world at rest.

        Fewer conditions allow more plans: what was in truth ordered by motions is no longer. It serves where
        the full domain has no plan, since no operator begins in the middle of things.
        """

        def keep(literals: frozenset[Literal], operator: Operator) -> frozenset[Literal]:
            type_of = {each.variable: each.type_name for each in operator.parameters}
            type_of |= dict(domain.constants)
            return frozenset(
                literal for literal in literals if not self.is_momentary(literal.atom, type_of, domain.types)
            )

        kept = [
            replace(
                operator,
                preconditions=keep(operator.preconditions, operator),
                effects=keep(operator.effects, operator),
            )
            for operator in domain.operators
        ]
        return replace(domain, operators=tuple(operator for operator in kept if operator.effects))
