"""Fast Downward, run as separate programs and never imported: it is GPL, and we are not."""

from demoplan.engines.fast_downward.diagnosing import diagnose
from demoplan.engines.fast_downward.installation import Installation, find_installation
from demoplan.engines.fast_downward.laddering import solve_widening
from demoplan.engines.fast_downward.searches import FIRST, OPTIMAL, Search
from demoplan.engines.fast_downward.solve import (
    Attempt,
    SolveParams,
    TextAnswer,
    plan_rows,
    solve,
    solve_text,
)
from demoplan.engines.fast_downward.translating import close_translators

__all__ = [
    "FIRST",
    "OPTIMAL",
    "Attempt",
    "Installation",
    "Search",
    "SolveParams",
    "TextAnswer",
    "close_translators",
    "diagnose",
    "find_installation",
    "plan_rows",
    "solve",
    "solve_text",
    "solve_widening",
]
