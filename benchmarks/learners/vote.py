"""The naive learner: votes over how often a literal was seen right before and right after its action."""

import itertools
from collections import Counter
from pathlib import Path

import reference

_MOST = 0.75
"""Share of the instances that makes a vote."""


def vote(case: Path) -> str:
    """A domain with a literal as condition if mostly seen before, as effect if mostly seen so after."""
    model = reference.read_domain(case / "domain.pddl")
    before: Counter[tuple[str, reference.Fact]] = Counter()
    after: Counter[tuple[str, reference.Fact]] = Counter()
    n: Counter[str] = Counter()
    over = {name: candidates(model, action) for name, action in model.actions.items()}
    for trace in sorted((case / "trajectories").glob("*_traj")):
        states, actions = reference.read_trace(trace)
        for state, (name, *arguments), following in zip(states, actions, states[1:], strict=False):
            n[name] += 1
            for fact in over[name]:
                (ground,) = model.actions[name].ground({fact}, tuple(arguments))
                before[name, fact] += ground in state
                after[name, fact] += ground in following
    for name, action in model.actions.items():
        for fact in over[name] if n[name] else ():
            was, became = before[name, fact] / n[name], after[name, fact] / n[name]
            if was >= _MOST:
                action.holds.add(fact)
            if became >= _MOST > was:
                action.adds.add(fact)
            if was >= _MOST and became <= 1 - _MOST:
                action.deletes.add(fact)
    return reference.domain_text(model, {name for name in model.actions if n[name]})


def candidates(model: reference.Model, action: reference.Action) -> list[reference.Fact]:
    found = []
    for predicate, types in model.predicates.items():
        fitting = [[name for name, kind in action.parameters if model.fits(kind, wanted)] for wanted in types]
        found += [(predicate, *chosen) for chosen in itertools.product(*fitting)]
    return found
