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

The table looks at one instant. A rule tree with memory also looks at what the instant is part of, with the
same thresholds: a rest with the object in hand is Take only before the object was carried; a motion that
comes to an object is Reach from its beginning; and an empty hand at rest at an object is Idle only if it
neither comes to grasp nor has just let go.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from demoplan.language.types import TypeHierarchy
from demoplan.stages.segment.features import relative_grip
from demoplan.stages.segment.tracks import Mask, Tracks
from demoplan.stages.segment.windows import last_true, n_ticks, next_true


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
    has_memory: bool = True
    """Whether an instant is seen as part of its motion, rest or grasp; as published, it is not."""
    opened: float = 0.9
    """A hand that is open by less than this share of its range is closing or opening."""
    letting_go_s: float = 0.5
    """A rest after letting go of something belongs to Release for this long at most [s]."""


PUBLISHED_RULES = RuleTree(has_memory=False)
"""The rule tree as published, with no granular activities."""

RULES = RuleTree()
"""The rule tree with memory, and no granular activities."""


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
    is_held = np.asarray(tracks.in_hand.any(axis=1))
    # What a hand holds is not what it acts on.
    acts_on = tracks.acted_on.copy()
    acts_on[:, : len(tracks.objects)] &= ~tracks.in_hand
    is_acting = np.asarray(acts_on.any(axis=1))
    classes = np.select(
        [is_held & ~tracks.is_moving, is_held, ~tracks.is_moving, is_acting],
        [index[TAKE], index[PUT], index[IDLE], index[REACH]],
        default=index[RELEASE],
    ).astype(np.int64)
    if tree.has_memory:
        classes = _with_memory(classes, index, tracks, is_held=is_held, is_acting=is_acting, tree=tree)
    kinds = [entities[name] for name in tracks.objects + tracks.surfaces]
    for rule in tree.granular:
        held = [i for i in range(len(tracks.objects)) if types.is_subtype(kinds[i], rule.held_type)]
        acted = [i for i, kind in enumerate(kinds) if types.is_subtype(kind, rule.acted_on_type)]
        applies = tracks.in_hand[:, held].any(axis=1) & acts_on[:, acted].any(axis=1)
        classes[applies] = index[rule.activity]
    return names, classes


def _with_memory(
    classes: NDArray[np.int64],
    index: Mapping[str, int],
    tracks: Tracks,
    *,
    is_held: Mask,
    is_acting: Mask,
    tree: RuleTree,
) -> NDArray[np.int64]:
    """The same classes, seen in the light of what comes before and after ``(h, t)``."""
    length = classes.shape[1]
    is_moving = tracks.is_moving
    is_empty = ~is_held
    last_held, next_held = last_true(is_held), next_true(is_held)
    last_move, next_move = last_true(is_moving), next_true(is_moving)
    last_rest, next_rest = last_true(~is_moving), next_true(~is_moving)

    # In hand: at rest before the first motion since it was grasped, or not.
    since_grasp = last_true(is_empty)
    was_carried = last_true(is_moving & is_held) > since_grasp
    classes = np.where(is_held & ~is_moving & was_carried, index[PUT], classes)

    # Empty and moving: what comes to an object reaches for it, from its beginning or, if it began by letting
    # go of another one, from where this one is approached; all other motion releases.
    end = np.minimum(next_rest, length) - 1
    comes_to_object = np.take_along_axis(is_acting & is_empty, end, axis=1) | (next_held <= next_rest)
    let_go_ticks = n_ticks(tree.letting_go_s, tracks.tick_s)
    begins_by_letting_go = (last_held >= 0) & (last_rest - last_held <= let_go_ticks)
    is_reach = comes_to_object & (is_acting | ~begins_by_letting_go)
    is_motion = is_empty & is_moving
    classes = np.where(is_motion, np.where(is_reach, index[REACH], index[RELEASE]), classes)

    # Empty and at rest: on the way into a grasp, or out of one.
    is_rest = is_empty & ~is_moving
    opening = relative_grip(tracks.grip)
    is_closing = (opening >= 0) & (opening < tree.opened)
    is_before_grasp = is_rest & (next_held < next_move) & (last_move > last_held)
    classes = np.where(is_before_grasp, np.where(is_closing, index[TAKE], index[REACH]), classes)
    is_letting_go = is_rest & (last_held >= 0) & (last_held >= last_move - 1)
    is_letting_go &= np.arange(length) - last_held <= let_go_ticks
    return np.where(is_letting_go, index[RELEASE], classes)
