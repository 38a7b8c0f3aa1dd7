"""Which search to run: named configurations of Fast Downward."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Search:
    """One configuration: its options on the command line, and what its plans are."""

    options: tuple[str, ...]
    is_optimal: bool = False
    """Plans cost the least possible."""


OPTIMAL = Search(("--search", "astar(lmcut())"), is_optimal=True)
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
