"""The executor, part by part.

Read in this order: ``params``; ``course``, a plan being carried out and what it expects of the world;
``hands``, motions and time; ``rows``, what is written down; ``experience`` and ``cases``, what a diagnosis
gets to know; ``discrepancies``, what is done about them; ``recovering``, the robot's own ways out;
``executor``, who dispatches.
"""

from demoplan.pipeline.execution.executing.endings import Ended
from demoplan.pipeline.execution.executing.executor import Executor
from demoplan.pipeline.execution.executing.params import ExecuteParams

__all__ = ["Ended", "ExecuteParams", "Executor"]
