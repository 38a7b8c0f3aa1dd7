"""MCAP files and ROS bags: into sample tables, and out of them."""

from demoplan.logs.diagnosing import InspectParams
from demoplan.logs.inspecting import inspect
from demoplan.logs.opening import fingerprint
from demoplan.logs.reading import Reading, SampleStream, open_log, read
from demoplan.logs.reporting import ClockReport, Finding, LogReport, TopicReport, TransformReport

__all__ = [
    "ClockReport",
    "Finding",
    "InspectParams",
    "LogReport",
    "Reading",
    "SampleStream",
    "TopicReport",
    "TransformReport",
    "fingerprint",
    "inspect",
    "open_log",
    "read",
]
