"""Tables to an episode view: what is drawn where, for how long, in which colour. No viewer is known here."""

import polars as pl

from demoplan.errors import UnknownNameError
from demoplan.language.vocabulary import Shape
from demoplan.viewers.describe import document_of
from demoplan.viewers.episode_view import Entity, EpisodeView
from demoplan.viewers.lanes import charts_of, fact_lanes_of, hand_lanes_of, notes_of
from demoplan.viewers.scene import body_of, contacts_of, trail_of, where_things_happen
from demoplan.viewers.sources import EpisodeTables, EpisodeViewParams


def compose_episode(tables: EpisodeTables, params: EpisodeViewParams | None = None) -> EpisodeView:
    """The view of one episode.

    Args:
        tables: What is known of it. What the frames hold and ``entities`` does not is drawn as a point.
        params: Choices of the view.

    Returns:
        Values to draw; lanes exist only for what ever held or could not be observed.

    Raises:
        UnknownNameError: If the frames hold nothing of the episode.
    """
    params = params or EpisodeViewParams()
    frames = tables.frames.filter(pl.col("episode_id") == tables.episode_id)
    if frames.is_empty():
        raise UnknownNameError(
            "episode", tables.episode_id, tables.frames["episode_id"].unique(), "the frames"
        )
    start_ns, end_ns, tick_ns = _span(frames)
    known = {entity.name: entity for entity in tables.entities}
    names = sorted({*frames["entity"].unique(), *(e.name for e in tables.entities if e.fixed_position_xyz_m)})
    entities = [
        known.get(n) or Entity(name=n, type_name="object", shape=Shape("point", (0, 0, 0))) for n in names
    ]
    tracks = {str(key[0]): part for key, part in frames.group_by("entity", maintain_order=True)}
    bodies = tuple(body_of(entity, tracks.get(entity.name), start_ns) for entity in entities)
    hands = tuple(body for body in bodies if body.entity.is_hand)
    facts = _of_episode(tables.facts, tables.episode_id)
    activities = _of_episode(tables.activities, tables.episode_id)
    truth = _of_episode(tables.truth, tables.episode_id)
    evidence = _of_episode(tables.evidence, tables.episode_id)
    focus, extent = where_things_happen(bodies)
    episode = None if tables.episodes is None else _of_episode(tables.episodes, tables.episode_id)
    return EpisodeView(
        episode_id=tables.episode_id,
        title=tables.episode_id,
        start_ns=start_ns,
        end_ns=end_ns,
        bodies=bodies,
        trails=tuple(trail_of(body, tick_ns, params) for body in hands),
        trail_ns=params.trail_ns,
        contacts=contacts_of(facts, bodies, params),
        hand_lanes=hand_lanes_of(activities, truth, evidence),
        fact_lanes=fact_lanes_of(facts),
        charts=charts_of(hands, tracks, tables.thresholds, params),
        notes=notes_of(evidence),
        document=document_of(
            tables.episode_id,
            None if episode is None or episode.is_empty() else episode.row(0, named=True),
            entities,
            tables.thresholds,
            start_ns=start_ns,
            end_ns=end_ns,
        ),
        focus_xyz_m=focus,
        extent_m=extent,
    )


def _of_episode(table: pl.DataFrame | None, episode_id: str) -> pl.DataFrame | None:
    return None if table is None else table.filter(pl.col("episode_id") == episode_id)


def _span(frames: pl.DataFrame) -> tuple[int, int, int]:
    """First tick, the tick after the last, and the time between ticks."""
    ticks = frames["tick_ns"].unique().sort()
    first, last = int(ticks[0]), int(ticks[-1])
    tick = int(ticks[1]) - first if len(ticks) > 1 else 1
    return first, last + tick, tick
