"""Which predicates only describe a motion in progress, and what operators say beside them.

An operator that was learned from watching states everything that was so around a transition: also that the
hand was moving, and where to. Such inputs of a classifier last as long as the motion does. A planner may
chain them, since they tell in which order activities follow. Nobody can demand them of a world that stands
still between two motions, or plan from them after one has failed: there only what lasts counts.

One flaw of such operators is mended here for whoever executes, and stands in the learned domain itself: that
an object is within a hand's grasp ends when the hand turns to another, and no operator says so, since an
operator speaks only of the objects that its activity is about. A plan made with the learned text alone may so
come back to an object that the hand has left. The mend is the usual compilation of "of one object at a time"
into one more predicate (:meth:`Momentary.one_thing_at_a_time`). It is put in when plans are made, sensed
never, and shown in no domain that is kept: evidence counts what was observed, and this was not.
"""

from dataclasses import dataclass, replace

from demoplan.language.atoms import Atom, Literal
from demoplan.language.domains import Domain, Operator, Signature
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
    one_at_a_time: tuple[str, ...] = ("graspable",)
    """Predicates (hand, object) that hold of one object at a time: a hand that comes near another has left
    the first. Who watches only what changes about the object that a motion is for never sees the first one
    cease, so no operator says it; :meth:`one_thing_at_a_time` does."""

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
                if literal.atom.predicate not in self._engaged
                and not self.is_momentary(literal.atom, type_of, types)
            ),
            adds=self._sensible(self.lasting_state(step.adds, type_of, types)),
            deletes=self._sensible(self.lasting_state(step.deletes, type_of, types)),
        )

    @property
    def _engaged(self) -> frozenset[str]:
        return frozenset(_engaged_name(predicate) for predicate in self.one_at_a_time)

    def _sensible(self, state: State) -> State:
        """Without what only planning knows of."""
        return frozenset(atom for atom in state if atom.predicate not in self._engaged)

    def one_thing_at_a_time(self, domain: Domain) -> Domain:
        """The domain in which a hand must be through with one object before it turns to another.

        For each predicate of ``one_at_a_time`` that operators add, a predicate of the hand alone says that it
        is so of something: whatever adds the one needs the other to be false and makes it true, whatever
        deletes it makes it false. A plan may then not come back to an object that a hand has left, as if it
        were still there.
        """
        declared = {signature.name: signature for signature in domain.predicates}
        for predicate in self.one_at_a_time:
            signature = declared.get(predicate)
            effects = {
                (effect.atom.predicate, effect.is_positive)
                for operator in domain.operators
                for effect in operator.effects
            }
            if signature is None or not {(predicate, True), (predicate, False)} <= effects:
                continue
            name = _engaged_name(predicate)
            new = Signature(name, signature.argument_types[:1])
            domain = replace(
                domain,
                predicates=tuple(sorted({*domain.predicates, new})),
                operators=tuple(_engaging(operator, predicate, name) for operator in domain.operators),
            )
        return domain

    def state_to_plan_from(self, state: State) -> State:
        """The atoms of a state without those of ``one_at_a_time``: hands are taken to begin away from things.

        A step that brings a hand to where it is already will be found done, and skipped.
        """
        return frozenset(atom for atom in state if atom.predicate not in self.one_at_a_time)

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

        # An operator that begins or ends nothing that lasts moves a hand and no more.
        kept = [
            replace(
                operator,
                preconditions=keep(operator.preconditions, operator),
                effects=keep(operator.effects, operator),
            )
            for operator in domain.operators
        ]
        return replace(domain, operators=tuple(operator for operator in kept if operator.effects))


def _engaged_name(predicate: str) -> str:
    return f"{predicate}-something"


def _engaging(operator: Operator, predicate: str, name: str) -> Operator:
    preconditions, effects = set(operator.preconditions), set(operator.effects)
    for effect in operator.effects:
        if effect.atom.predicate != predicate:
            continue
        engaged = Atom(name, effect.atom.arguments[:1])
        if effect.is_positive:
            preconditions.add(Literal(engaged, False))
        effects.add(Literal(engaged, effect.is_positive))
    return replace(operator, preconditions=frozenset(preconditions), effects=frozenset(effects))
