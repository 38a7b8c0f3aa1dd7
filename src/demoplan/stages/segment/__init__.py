"""Frames and facts to activities: the published rule tree, or a tree trained from labelled episodes."""

from demoplan.stages.segment.model import Segmenter, parse_segmenter, render_segmenter
from demoplan.stages.segment.rules import PUBLISHED_RULES, RULE_ACTIVITIES, RULES, GranularActivity, RuleTree
from demoplan.stages.segment.segmentation import SegmentParams, segment
from demoplan.stages.segment.training import TrainParams, segment_held_out, train

__all__ = [
    "PUBLISHED_RULES",
    "RULES",
    "RULE_ACTIVITIES",
    "GranularActivity",
    "RuleTree",
    "SegmentParams",
    "Segmenter",
    "TrainParams",
    "parse_segmenter",
    "render_segmenter",
    "segment",
    "segment_held_out",
    "train",
]
