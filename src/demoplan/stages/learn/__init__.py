"""Transitions to operators: few, right, and with the evidence behind each literal.

Read in order: ``encode`` (names to integers), ``mend`` (misreadings put right, with ``courses``,
``misreadings`` and ``exclusion``), ``settle`` (changes that a boundary cut in two), ``bind`` (which objects
matter), ``lift`` (instances to variables), ``merge`` (which transitions are one operator), ``relevance`` and
``decide`` (which literals are stated), ``sound`` and ``reach`` (that plans are possible and safe), and
``learning``, which puts them together. ``splitting`` finds types whose objects behave unlike, and
``retyping`` makes types of their own for them.
"""

from demoplan.stages.learn.learning import (
    Learned,
    learn,
    learn_splitting_types,
    planner_cost,
    success_probability,
)
from demoplan.stages.learn.params import LearnParams
from demoplan.stages.learn.retyping import Retyping

__all__ = [
    "LearnParams",
    "Learned",
    "Retyping",
    "learn",
    "learn_splitting_types",
    "planner_cost",
    "success_probability",
]
