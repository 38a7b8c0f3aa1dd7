"""Samples to frames: everything that a log says, on one clock, in one frame of reference."""

from demoplan.stages.align.align import align
from demoplan.stages.align.long import align_parts
from demoplan.stages.align.streams import AlignParams

__all__ = ["AlignParams", "align", "align_parts"]
