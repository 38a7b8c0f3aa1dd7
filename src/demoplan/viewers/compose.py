"""Tables to an episode view: what is drawn where, for how long, in which colour. No viewer is known here."""

from typing import Any

import polars as pl

from demoplan.errors import UnknownNameError
from demoplan.language.vocabulary import Shape
from demoplan.viewers.describe import document_of, document_of_run, properties_of, properties_of_run
from demoplan.viewers.episode_view import Body, Entity, EpisodeView, Log, Segments
from demoplan.viewers.execution_lanes import (
    diagnoses_of,
    dispatched,
    events_of,
    plan_lanes_of,
    step_lanes_of,
)
from demoplan.viewers.lanes import charts_of, fact_lanes_of, hand_lanes_of, notes_of, relation_lanes_of
from demoplan.viewers.scene import body_of, contacts_of, trail_of, where_things_happen
from demoplan.viewers.sources import LAYERS, EpisodeTables, EpisodeViewParams


def compose_episode(tables: EpisodeTables, params: EpisodeViewParams | None = None) -> EpisodeView:
    """The view of one episode, or of one execution.

    Args:
        tables: What is known of it. What the frames hold and ``entities`` does not is drawn as a point.
        params: Choices of the view.

    Returns:
        Values to draw; lanes exist only for what ever held or could not be observed, and only for the layers
        that were asked for.

    Raises:
        UnknownNameError: If the frames hold nothing of the episode and no steps are known, or a layer is
            unknown.
    """
    params = params or EpisodeViewParams()
    for layer in params.layers:
        if layer not in LAYERS:
            raise UnknownNameError("layer", layer, LAYERS)
    frames = tables.frames.filter(pl.col("episode_id") == tables.episode_id)
    steps = tables.steps
    if frames.is_empty() and (steps is None or dispatched(steps).is_empty()):
        raise UnknownNameError(
            "episode", tables.episode_id, tables.frames["episode_id"].unique(), "the frames"
        )
    start_ns, end_ns, tick_ns = _span(frames, steps)
    has = {layer: layer in params.layers for layer in LAYERS}
    facts = _of_episode(tables.facts, tables.episode_id)
    evidence = _of_episode(tables.evidence, tables.episode_id)
    bodies, tracks = _bodies(tables, frames, start_ns) if has["raw"] else ((), {})
    hands = tuple(body for body in bodies if body.entity.is_hand)
    focus, extent = where_things_happen(bodies)
    hand_lanes = (
        hand_lanes_of(
            _of_episode(tables.activities, tables.episode_id),
            _of_episode(tables.truth, tables.episode_id),
            evidence,
        )
        if has["activities"]
        else ()
    )
    if has["execution"] and steps is not None:
        hand_lanes = (*hand_lanes, *step_lanes_of(steps))
    about = _about(tables, start_ns, end_ns)
    return EpisodeView(
        episode_id=tables.episode_id,
        **about,
        start_ns=start_ns,
        end_ns=end_ns,
        bodies=bodies,
        trails=tuple(trail_of(body, tick_ns, params) for body in hands),
        trail_ns=params.trail_ns,
        contacts=contacts_of(facts if bodies else None, bodies, params) if bodies else Segments.none(),
        plan_lanes=plan_lanes_of(steps, end_ns) if has["execution"] and steps is not None else (),
        hand_lanes=hand_lanes,
        relation_lanes=relation_lanes_of(facts) if has["predicates"] else (),
        fact_lanes=fact_lanes_of(facts) if has["predicates"] else (),
        charts=charts_of(hands, tracks, tables.thresholds, params),
        logs=_logs(tables, evidence, has),
        focus_xyz_m=focus,
        extent_m=extent,
    )


def _bodies(
    tables: EpisodeTables, frames: pl.DataFrame, start_ns: int
) -> tuple[tuple[Body, ...], dict[str, pl.DataFrame]]:
    """What the scene holds, and the frames of each."""
    if frames.is_empty():
        return (), {}
    known = {entity.name: entity for entity in tables.entities}
    names = sorted({*frames["entity"].unique(), *(e.name for e in tables.entities if e.fixed_position_xyz_m)})
    tracks = {str(key[0]): part for key, part in frames.group_by("entity", maintain_order=True)}
    entities = [
        known.get(n) or Entity(name=n, type_name="object", shape=Shape("point", (0, 0, 0))) for n in names
    ]
    return tuple(body_of(entity, tracks.get(entity.name), start_ns) for entity in entities), tracks


def _about(tables: EpisodeTables, start_ns: int, end_ns: int) -> dict[str, Any]:
    """Kind, title, properties and description."""
    duration_s = (end_ns - start_ns) * 1e-9
    if tables.run is not None:
        run = tables.run.row(0, named=True)
        return {
            "kind": "execution",
            "title": f"{tables.goal or run['goal']} ({run['outcome']})",
            "properties": properties_of_run(run, duration_s=duration_s, goal=tables.goal),
            "document": document_of_run(run, duration_s=duration_s, goal=tables.goal),
        }
    rows = None if tables.episodes is None else _of_episode(tables.episodes, tables.episode_id)
    episode = None if rows is None or rows.is_empty() else rows.row(0, named=True)
    return {
        "kind": "demonstration",
        "title": tables.episode_id,
        "properties": properties_of(tables.episode_id, episode, duration_s=duration_s, goal=tables.goal),
        "document": document_of(
            tables.episode_id,
            episode,
            tables.entities,
            tables.thresholds,
            start_ns=start_ns,
            end_ns=end_ns,
            goal=tables.goal,
        ),
    }


def _logs(tables: EpisodeTables, evidence: pl.DataFrame | None, has: dict[str, bool]) -> tuple[Log, ...]:
    """What happened, which operators matched, and why: those of them that there is something to say in."""
    run = None if tables.run is None else tables.run.row(0, named=True)
    logs = []
    if has["execution"] and tables.steps is not None:
        logs.append(Log(name="events", title="What happened", notes=events_of(tables.steps, run)))
    if has["activities"]:
        logs.append(Log(name="operators", title="Operators matched", notes=notes_of(evidence)))
    if has["explanation"]:
        found = () if tables.steps is None else diagnoses_of(tables.steps)
        notes = tuple(sorted((*found, *tables.reasons), key=lambda note: note.tick_ns))
        logs.append(Log(name="why", title="Why", notes=notes))
    return tuple(log for log in logs if log.notes)


def _of_episode(table: pl.DataFrame | None, episode_id: str) -> pl.DataFrame | None:
    return None if table is None else table.filter(pl.col("episode_id") == episode_id)


def _span(frames: pl.DataFrame, steps: pl.DataFrame | None) -> tuple[int, int, int]:
    """First tick, the tick after the last, and the time between ticks."""
    if frames.is_empty():
        assert steps is not None
        return 0, int(max(dispatched(steps)["end_ns"])), 1
    ticks = frames["tick_ns"].unique().sort()
    first, last = int(ticks[0]), int(ticks[-1])
    tick = int(ticks[1]) - first if len(ticks) > 1 else 1
    return first, last + tick, tick
