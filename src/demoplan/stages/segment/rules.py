"""The published rule tree: activities without any labels, from motion, what is held and what is acted on.

| moving | acted on | in hand | activity |
| --- | --- | --- | --- |
| no | – | – | Idle |
| yes | object | – | Reach |
| no | – | object | Take |
| yes | – | object | Put |
| yes | – | – | Release |
| any | object | object | named by the classes of both, where such a name is given |

Source: K. Ramirez-Amaro, M. Beetz, G. Cheng, "Transferring skills to humanoid robots by extracting semantic
representations from observations of human activities", Artificial Intelligence 247 (2017),
doi:10.1016/j.artint.2015.08.009. Differences: motion has hysteresis, distances are between surfaces, and an
object of the held one's class can be acted on.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.language.types import TypeHierarchy
from demoplan.stages.segment.tracks import Tracks


@dataclass(frozen=True, order=True, kw_only=True)
class GranularActivity:
    """The name of doing something with one class of object to another: pour, cut, stir."""

    held_type: str
    acted_on_type: str
    activity: str


@dataclass(frozen=True, kw_only=True)
class RuleTree:
    """The rule tree, and the granular activities that a dataset names."""

    granular: tuple[GranularActivity, ...] = ()


PUBLISHED_RULES = RuleTree()
"""The rule tree as published, with no granular activities."""


IDLE, REACH, TAKE, PUT, RELEASE = "Idle", "Reach", "Take", "Put", "Release"
RULE_ACTIVITIES = (IDLE, REACH, TAKE, PUT, RELEASE)


def classify_by_rules(
    tracks: Tracks, tree: RuleTree, entities: Mapping[str, str], types: TypeHierarchy
) -> tuple[tuple[str, ...], NDArray[np.int64]]:
    """The activity of every hand at every tick, by the rule tree.

    Args:
        tracks: The episode's arrays.
        tree: Granular activities; a pair of classes without a name falls back to Take and Put.
        entities: Instance → type.
        types: Hierarchy, so that a rule for ``Container`` speaks of bowls too.

    Returns:
        Names of the activities, and an index into them for each hand and tick ``(h, t)``.
    """
    names = (*RULE_ACTIVITIES, *sorted({rule.activity for rule in tree.granular} - set(RULE_ACTIVITIES)))
    index = {name: i for i, name in enumerate(names)}
    is_held = tracks.in_hand.any(axis=1)
    # What a hand holds is not what it acts on.
    acts_on = tracks.acted_on.copy()
    acts_on[:, : len(tracks.objects)] &= ~tracks.in_hand
    is_acting = acts_on.any(axis=1)
    classes = np.select(
        [is_held & ~tracks.is_moving, is_held, ~tracks.is_moving, is_acting],
        [index[TAKE], index[PUT], index[IDLE], index[REACH]],
        default=index[RELEASE],
    ).astype(np.int64)
    kinds = [entities[name] for name in tracks.objects + tracks.surfaces]
    for rule in tree.granular:
        held = [i for i in range(len(tracks.objects)) if types.is_subtype(kinds[i], rule.held_type)]
        acted = [i for i, kind in enumerate(kinds) if types.is_subtype(kind, rule.acted_on_type)]
        applies = tracks.in_hand[:, held].any(axis=1) & acts_on[:, acted].any(axis=1)
        classes[applies] = index[rule.activity]
    return names, classes
