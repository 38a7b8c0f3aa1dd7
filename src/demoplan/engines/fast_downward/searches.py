"""Which search to run: named configurations of Fast Downward.

Seconds of search, and cost where it differs, on random towers with the hand-written stacking domain of the
tests (7 operators, two hands; one start and goal per column, 2 cores shared, 6 s limit):

| search | 4 cubes | 5 cubes | 6 cubes | 6 cubes, other | 7 cubes | 15 cubes |
| --- | --- | --- | --- | --- | --- | --- |
| A* with LM-cut | 0.08 | 0.06 | 2.26 | over 6 | – | – |
| A* with landmark cost partitioning | 0.02 | 0.03 | 0.09 | 0.48 | 3.8 | – |
| A* with pattern databases (iPDB, 1 s) | 0.02 | 0.02 | 0.24 | 0.69 | – | – |
| LAMA, first iteration | 0.01 (42 for 27) | 0.01 | 0.01 (46 for 43) | 0.01 (59 for 41) | 0.04 | 0.3 |

So the cheapest plan is looked for where it comes well within a second (up to 5 cubes), and any plan beyond:
``benchmarks/planning.py`` measures it again.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class Search:
    """One configuration: its options on the command line, and what its plans are."""

    options: tuple[str, ...]
    is_optimal: bool = False
    """Plans cost the least possible."""


OPTIMAL = Search(
    (
        "--search",
        "let(marks, landmark_cost_partitioning(lm_reasonable_orders_hps(lm_merged([lm_rhw(), lm_hm(m=1)]))),"
        " astar(marks, lazy_evaluator=marks))",
    ),
    is_optimal=True,
)
"""A* with admissible landmarks, known as BJOLP.

Source: E. Karpas, C. Domshlak, "Cost-optimal planning with landmarks", IJCAI 2009.
"""

LM_CUT = Search(("--search", "astar(lmcut())"), is_optimal=True)
"""Source: M. Helmert, C. Domshlak, "Landmarks, critical paths and abstractions", ICAPS 2009."""

FIRST = Search(
    (
        "--search",
        "let(marks, eval_modify_costs(landmark_sum(lm_factory=lm_reasonable_orders_hps(lm_rhw()),"
        " pref=false), cost_type=one), let(relaxed, eval_modify_costs(ff(), cost_type=one),"
        " lazy_greedy([relaxed, marks], preferred=[relaxed, marks], cost_type=one, reopen_closed=false)))",
    )
)
"""The first iteration of LAMA: fast, blind to costs.

Source: S. Richter, M. Westphal, "The LAMA planner", JAIR 39, 2010, doi:10.1613/jair.2972.
"""
