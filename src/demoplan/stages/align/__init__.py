"""Samples to frames: everything that a log says, on one clock, in one frame of reference."""

from demoplan.stages.align.align import AlignParams, align

__all__ = ["AlignParams", "align"]
