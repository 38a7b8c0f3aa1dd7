"""What literals are to actions, from noisy observations before and after: numbers in, probabilities out.

Nothing here knows of traces, logs or PDDL: literals, predicates and timelines are row numbers. ``roles`` are
the hypotheses about one literal; ``timelines`` hold what was observed; ``chains`` follow each ground atom
over time; ``beliefs`` passes messages between literals and timelines and estimates how often observations are
wrong; ``pairs`` is the special case in which all that is known are counts of (before, after).
"""

from demoplan.inference.beliefs import Beliefs, believe
from demoplan.inference.chains import FlipRates, Messages
from demoplan.inference.pairs import FALSE, TRUE, UNSEEN, believe_pairs, timelines_of_pairs
from demoplan.inference.roles import ADD, DELETE, KEEP, BeliefParams, Roles
from demoplan.inference.timelines import Timelines

__all__ = [
    "ADD",
    "DELETE",
    "FALSE",
    "KEEP",
    "TRUE",
    "UNSEEN",
    "BeliefParams",
    "Beliefs",
    "FlipRates",
    "Messages",
    "Roles",
    "Timelines",
    "believe",
    "believe_pairs",
    "timelines_of_pairs",
]
