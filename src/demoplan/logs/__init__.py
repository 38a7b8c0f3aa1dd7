"""MCAP files and ROS bags: into sample tables, and out of them."""

from demoplan.logs.opening import fingerprint
from demoplan.logs.reading import Reading, SampleStream, open_log, read

__all__ = ["Reading", "SampleStream", "fingerprint", "open_log", "read"]
