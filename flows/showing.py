"""Results as Prefect artifacts: for the person who looks in the morning."""

from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

import polars as pl
from prefect.artifacts import (
    acreate_link_artifact,
    acreate_markdown_artifact,
    acreate_table_artifact,
)

from demoplan.language.diff import Change
from demoplan.pipeline.domains.study import Tried
from demoplan.pipeline.run import RunResult
from demoplan.pipeline.upkeep.versions import NewVersion
from demoplan.store import EpisodeState, Store

MOST_CAUSES = 10
MOST_ROWS = 1000
"""Rows of a table that go into an artifact: it is kept in Prefect's database."""


def key_of(*parts: str) -> str:
    """A name that Prefect takes for an artifact: lower-case letters, digits and dashes.

    >>> key_of("Episodes", "cube_stacking")
    'episodes-cube-stacking'
    """
    text = "-".join(parts).lower()
    return "-".join("".join(c if c.isascii() and c.isalnum() else " " for c in text).split())


async def show_episodes(dataset: str, states: Sequence[EpisodeState]) -> None:
    """What became of each episode; those that lost data first."""
    ordered = sorted(states, key=lambda s: (s.status == "complete", s.episode_id))
    await acreate_table_artifact(
        key=key_of("episodes", dataset),
        description=f"{len(states)} episodes, {sum(s.status != 'complete' for s in states)} with data lost",
        table=[
            {"episode": s.episode_id, "status": s.status, "reason": s.reason or ""}
            for s in ordered[:MOST_ROWS]
        ],
    )


async def show_version(dataset: str, version: NewVersion) -> None:
    """What the new version of a domain says otherwise than the one before."""
    await acreate_markdown_artifact(
        key=key_of("domain-diff", dataset), markdown=diff_text(dataset, version), description="Domain diff"
    )


def diff_text(dataset: str, version: NewVersion) -> str:
    """The difference of two domain versions as Markdown."""
    now = version.learned.version
    n_episodes = len(now.episodes)
    head = f"# {dataset}: domain `{now.domain_id}`\n\n{now.n_operators} operators from {n_episodes} episodes."
    if version.previous is None:
        return f"{head}\n\nThe first version.\n"
    return f"{head}\n\n{changes_text(version.previous.version.domain_id, version.changes)}"


def changes_text(previous_id: str, changes: Sequence[Change]) -> str:
    """Differences as a list in Markdown."""
    if not changes:
        return f"It says the same as `{previous_id}`.\n"
    lines = "\n".join(f"- {_escaped(str(change))}" for change in changes[:MOST_ROWS])
    return f"{len(changes)} differences from `{previous_id}`:\n\n{lines}\n"


async def show_success(dataset: str, tried: Sequence[Tried]) -> None:
    """Domain × goal: which are solved, and why the others are not."""
    await acreate_table_artifact(
        key=key_of("success", dataset), table=success_matrix(tried), description=f"{dataset}: domain × goal"
    )


def success_matrix(tried: Sequence[Tried]) -> list[dict[str, str]]:
    """One row per domain, one column per goal."""
    rows: dict[str, dict[str, str]] = {}
    for each in tried:
        row = rows.setdefault(each.trial.domain, {"domain": each.trial.domain})
        row[each.trial.goal] = each.trial.cause or "solved"
    return [rows[name] for name in sorted(rows)]


async def show_run(dataset: str, version: NewVersion, result: RunResult) -> None:
    """What came of a whole run, in a few lines."""
    await acreate_markdown_artifact(
        key=key_of("run-report", dataset),
        markdown=run_text(dataset, version, result.states, result.tried),
        description="Run report",
    )


def run_text(
    dataset: str, version: NewVersion, states: Sequence[EpisodeState], tried: Sequence[Tried]
) -> str:
    """Episodes by what became of them, the domain, and how many goals are solved, as Markdown."""
    statuses = Counter(state.status for state in states)
    domain = version.learned.version.domain_id
    if version.previous is None:
        news = "the first version"
    elif version.is_new:
        news = f"a new version, {len(version.changes)} differences from the one before"
    else:
        news = "as it was before"
    causes = Counter(each.trial.cause for each in tried if each.trial.cause is not None)
    lines = [
        f"# {dataset}",
        f"- {len(states)} episodes: {', '.join(f'{n} {name}' for name, n in sorted(statuses.items()))}",
        *(f"  - {_escaped(s.episode_id)}: {_escaped(s.reason or s.status)}" for s in states if s.reason),
        f"- domain `{domain}`: {news}",
        f"- {sum(t.trial.is_solved for t in tried)} of {len(tried)} pairs of domain and goal are solved",
        *(f"  - {n} × {_escaped(cause)}" for cause, n in causes.most_common(MOST_CAUSES)),
    ]
    return "\n".join(lines[:MOST_ROWS]) + "\n"


async def show_stale(rows: pl.DataFrame, cost_s: float) -> None:
    """What is stale, and why."""
    shown = rows.head(MOST_ROWS).with_columns(pl.col("reason").cast(pl.String))
    await acreate_table_artifact(
        key="stale", table=shown.to_dicts(), description=f"{rows.height} stage runs, about {cost_s:.0f} s"
    )


async def show_links(store: Store, dataset: str, report: str | None) -> None:
    """Where the report and the recordings are."""
    if report is not None:
        await show_report(key_of("report", dataset), report)
    if store.place.path("") is None:
        return
    recordings = sorted((store.root / "recordings" / dataset).glob("*.rrd"))[:MOST_ROWS]
    if recordings:
        lines = [f"- [{path.stem}](file://{quote(str(path.resolve()))})" for path in recordings]
        await acreate_markdown_artifact(
            key=key_of("recordings", dataset), markdown="\n".join(lines), description="Recordings for rerun"
        )


async def show_report(key: str, report: str) -> None:
    """Where a report is: a path on this machine, or a URL."""
    link = report if "://" in report else Path(report).resolve().as_uri()
    await acreate_link_artifact(key=key, link=link, link_text=report.rpartition("/")[2])


def _escaped(text: str) -> str:
    return "".join(f"\\{c}" if c in "\\`*_<>[]#|" else c for c in text)
