"""The declared tables: read these in order to learn the product.

``samples`` → ``frames`` → ``facts`` → ``activities`` → ``transitions`` → ``operators``, ``literals``,
``evidence``, ``findings`` → ``plans`` → ``scores``, ``confusions``; ``episodes`` and ``topics`` say what was
read.

Conventions: plural nouns; ``<thing>_id``; ``n_<things>``; units in names; time is integer nanoseconds,
intervals are half-open ``[start_ns, end_ns)``; same name, same quantity, same unit in every table.
"""

from demoplan.tables.activities import Activities
from demoplan.tables.confusions import Confusions
from demoplan.tables.episodes import Episodes, Topics
from demoplan.tables.executions import Executions, FaultCases, Runs
from demoplan.tables.facts import Facts
from demoplan.tables.findings import Findings
from demoplan.tables.frames import Frames
from demoplan.tables.operators import Evidence, Literals, Operators
from demoplan.tables.plans import Plans
from demoplan.tables.samples import Samples
from demoplan.tables.scores import Scores
from demoplan.tables.sightings import Patterns, Sightings, Votes
from demoplan.tables.transitions import Transitions

__all__ = [
    "Activities",
    "Confusions",
    "Episodes",
    "Evidence",
    "Executions",
    "Facts",
    "FaultCases",
    "Findings",
    "Frames",
    "Literals",
    "Operators",
    "Patterns",
    "Plans",
    "Runs",
    "Samples",
    "Scores",
    "Sightings",
    "Topics",
    "Transitions",
    "Votes",
]
