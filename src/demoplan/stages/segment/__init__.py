"""Frames and facts to activities: the published rule tree, or a tree trained from labelled episodes.

`demoplan.stages.segment.training` fits; it is imported by itself because scikit-learn takes a second to load.
"""

from demoplan.stages.segment.model import Segmenter, parse_segmenter, render_segmenter
from demoplan.stages.segment.rules import PUBLISHED_RULES, GranularActivity, RuleTree
from demoplan.stages.segment.segmentation import SegmentParams, segment

__all__ = [
    "PUBLISHED_RULES",
    "GranularActivity",
    "RuleTree",
    "SegmentParams",
    "Segmenter",
    "parse_segmenter",
    "render_segmenter",
    "segment",
]
