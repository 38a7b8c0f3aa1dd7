"""What an episode view is made from: tables, entities with their shapes, thresholds and choices."""

from dataclasses import dataclass

import dataframely as dy

from demoplan.language.vocabulary import Vocabulary
from demoplan.manifests.mapping import Mapping
from demoplan.stages.perceive import PerceiveParams
from demoplan.stages.perceive.bodies import shape_of
from demoplan.tables import Activities, Episodes, Evidence, Executions, Facts, Frames, Runs
from demoplan.viewers.episode_view import Entity, Note, Threshold

LAYERS = ("raw", "activities", "predicates", "execution", "explanation")
"""Parts of a view: scene and signals; what hands did, and which operators that matched; what held; plans and
steps; and why."""


@dataclass(frozen=True, kw_only=True)
class EpisodeViewParams:
    """What can be chosen about an episode view."""

    layers: tuple[str, ...] = LAYERS
    """Which parts are shown; see ``LAYERS``."""

    trail_ns: int = 1_500_000_000
    """How far back a hand's trail shows [ns]."""
    trail_step_ns: int = 20_000_000
    """Shortest stretch of a trail that is drawn as one line [ns]."""
    contact_step_ns: int = 40_000_000
    """How often contact lines are redrawn [ns]."""
    contact_predicate: str = "inTouch"
    """Binary predicate whose atoms are drawn as lines."""
    speed_window_s: float = PerceiveParams().velocity_window_s
    """Window of a hand's speed: that of the stage which compares it with its thresholds [s]."""
    surface_extent_m: float = 0.3
    """A contact with a body wider than this is drawn to its nearest point, not to its middle [m]."""


@dataclass(frozen=True, kw_only=True)
class EpisodeTables:
    """What is known of an episode. Tables may hold other episodes too; their rows are left out.

    ``truth`` has the form of activities; ``evidence`` says which operator each activity matched. An execution
    is an episode with ``run`` (one row) and ``steps``, on one clock with its frames, if these were kept.
    """

    episode_id: str
    frames: dy.DataFrame[Frames]
    entities: tuple[Entity, ...]
    episodes: dy.DataFrame[Episodes] | None = None
    facts: dy.DataFrame[Facts] | None = None
    activities: dy.DataFrame[Activities] | None = None
    truth: dy.DataFrame[Activities] | None = None
    evidence: dy.DataFrame[Evidence] | None = None
    run: dy.DataFrame[Runs] | None = None
    steps: dy.DataFrame[Executions] | None = None
    reasons: tuple[Note, ...] = ()
    """Why activities and facts are what they are."""
    goal: str | None = None
    """What was to be reached, as goal text."""
    thresholds: tuple[Threshold, ...] = ()


def entities_of(mapping: Mapping, vocabulary: Vocabulary) -> tuple[Entity, ...]:
    """The mapping's instances with their types and extents, sorted by name.

    An instance takes its own shape, else its type's, else its nearest ancestor's, else it is a point. Hands
    and surfaces are what stands below the types ``Hand`` and ``Surface``, where the vocabulary has them.
    """
    types = vocabulary.types

    def is_a(type_name: str, family: str) -> bool:
        return family in types.ancestors(type_name)

    return tuple(
        Entity(
            name=name,
            type_name=entity.type,
            shape=shape_of(entity, vocabulary),
            is_hand=is_a(entity.type, "Hand"),
            is_surface=is_a(entity.type, "Surface"),
            fixed_position_xyz_m=None if entity.fixed is None else entity.fixed.position_xyz_m,
            fixed_orientation_wxyz=(1.0, 0.0, 0.0, 0.0)
            if entity.fixed is None
            else entity.fixed.orientation_wxyz,
        )
        for name, entity in sorted(mapping.entities.items())
    )


_SIGNALS = {"moving": "speed", "hand_open": "grip"}
"""Definitions that compare one signal of a hand with an enter and an exit number."""


def thresholds_of(vocabulary: Vocabulary) -> tuple[Threshold, ...]:
    """The vocabulary's numbers that a hand's speed or grip is compared with, in its order."""
    return tuple(
        Threshold(quantity=_SIGNALS[rule.definition], name=f"{rule.signature.name}.{name}", value=value)
        for rule in vocabulary.predicates
        if rule.definition in _SIGNALS
        for name, value in rule.numbers
        if name.startswith(("enter_", "exit_"))
    )
