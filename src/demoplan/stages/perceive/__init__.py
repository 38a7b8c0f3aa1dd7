"""Frames to facts: what held when, by the geometric definitions that a vocabulary names."""

from demoplan.stages.perceive.perceive import PerceiveParams, perceive, perceive_parts
from demoplan.stages.perceive.registry import DEFINITIONS, check_definitions

__all__ = ["DEFINITIONS", "PerceiveParams", "check_definitions", "perceive", "perceive_parts"]
