"""Literals of which all that is known is how often they were seen how, before and after their action.

Transitions of logs are far apart: what an atom was between them is not known, and each transition is on its
own. Then counts say everything that the transitions say, and as many as one likes cost nothing.
"""

import numpy as np

from demoplan.inference.beliefs import Beliefs, believe
from demoplan.inference.roles import BeliefParams, Ints
from demoplan.inference.timelines import Timelines

UNSEEN, FALSE, TRUE = 0, 1, 2
"""How an atom was observed; index into the last two axes of counts."""


def believe_pairs(counts: Ints, predicate: Ints, n_predicates: int, params: BeliefParams) -> Beliefs:
    """Beliefs about literals from counts of (before, after), and how often observations are wrong.

    Args:
        counts: ``(n_literals, 3, 3)``: transitions in which the literal was seen so before and so after its
            action, ``UNSEEN``, ``FALSE`` or ``TRUE`` each. They add up over transitions, so adding a
            demonstration is a sum and forgetting one a difference.
        predicate: ``(n_literals,)``: predicate of each literal.
        n_predicates: How many predicates there are.
        params: Priors and limits.

    Returns:
        Beliefs in the order of the literals. The order of rows does not matter to them.
    """
    return believe(timelines_of_pairs(counts, predicate), predicate, n_predicates, params)


def timelines_of_pairs(counts: Ints, predicate: Ints) -> Timelines:
    """One timeline of one touch for every cell that is not empty, standing for so many transitions."""
    literal, before, after = np.nonzero(counts)
    return Timelines(
        n_by_rank=(len(literal),) if len(literal) else (),
        timeline_predicate=predicate[literal],
        before_true=(before == TRUE).astype(np.float64),
        before_false=(before == FALSE).astype(np.float64),
        after_true=(after == TRUE).astype(np.float64),
        after_false=(after == FALSE).astype(np.float64),
        entry_literal=literal,
        entry_touch=np.arange(len(literal)),
        n_alike=counts[literal, before, after].astype(np.float64),
    )
