"""The report: every section composed from tables, then one template around them."""

import base64

from demoplan.viewers.colours import activity_colour, operator_colour
from demoplan.viewers.report.activity_bars import activity_names, episode_bars
from demoplan.viewers.report.content import ReportContent
from demoplan.viewers.report.episode_rows import EpisodeRow, episode_rows, failure_rows
from demoplan.viewers.report.glossary import GLOSSARY
from demoplan.viewers.report.markup import counted, swatch
from demoplan.viewers.report.operator_cards import OperatorCard, operator_cards
from demoplan.viewers.report.page import page_of
from demoplan.viewers.report.pddl_text import coloured
from demoplan.viewers.report.plan_matrix import PlanMatrix, plan_matrix
from demoplan.viewers.report.scores import confusion_grid, key_results, score_grid

_OPEN_EPISODES = 24
"""More episodes than this are folded: a page should open quickly."""


def render_report(content: ReportContent) -> str:
    """The report as one HTML page.

    It needs no other file, no network and no script; it follows the reader's light or dark setting, and
    prints. Names and texts from logs are shown as text, whatever they hold.

    Args:
        content: The tables. Sections without a table are left out.

    Returns:
        The page; the same content gives the same text, whatever order the tables' rows are in.
    """
    matrix = plan_matrix(content.plans, content.domains, content.goals, content.refuted)
    episodes = episode_rows(content)
    cards = operator_cards(content)
    bars = episode_bars(content.activities, content.truth)
    results = key_results(content.scores, content.references, content.methods)
    suites = () if content.scores is None else tuple(sorted(content.scores["suite"].unique()))
    grids = [(suite, grid) for suite in suites if (grid := score_grid(content.scores, suite)) is not None]
    return page_of(
        "report.html",
        content=content,
        tiles=_tiles(episodes, cards, content, matrix),
        troubled=[row for row in episodes if row.status != "complete"],
        episodes=episodes,
        results=results,
        has_references=any(row.reference for row in results),
        grids=grids,
        bars=bars,
        are_bars_open=len(bars) <= _OPEN_EPISODES,
        legend=[
            (name, swatch(activity_colour(name)))
            for name in activity_names(content.activities, content.truth)
        ],
        has_truth=content.truth is not None and not content.truth.is_empty(),
        confusions=[confusion_grid(confusion) for confusion in content.confusions],
        cards=[(card, swatch(operator_colour(card.activity))) for card in cards],
        findings=_findings(content),
        domains=[(domain, coloured(domain.text)) for domain in content.domains if domain.text],
        matrix=matrix,
        failures=failure_rows(content, matrix),
        pictures=[(p.caption, base64.b64encode(p.png).decode("ascii")) for p in content.pictures],
        glossary=GLOSSARY,
    )


_KINDS = ("type", "misreading", "exclusion", "variant")
"""Kinds of findings, those to decide on first."""


def _findings(content: ReportContent) -> list[tuple[str, str, str, str, str]]:
    """Kind, subject, statement, odds, and whether operators were learned with it."""
    if content.findings is None:
        return []
    rows = sorted(
        content.findings.iter_rows(named=True), key=lambda row: (_KINDS.index(row["kind"]), row["subject"])
    )
    return [
        (
            row["kind"],
            row["subject"],
            row["statement"],
            "" if row["log10_bayes_factor"] is None else f"10^{row['log10_bayes_factor']:.1f}",
            "applied" if row["is_applied"] else "proposed" if row["kind"] == "type" else "",
        )
        for row in rows
    ]


def _tiles(
    episodes: tuple[EpisodeRow, ...],
    cards: tuple[OperatorCard, ...],
    content: ReportContent,
    matrix: PlanMatrix | None,
) -> list[tuple[str, str, str]]:
    """(figure, what it counts, what to know about it), for the page's head."""
    bad = sum(row.status == "quarantined" for row in episodes)
    cut = sum(row.status == "truncated" for row in episodes)
    notes = [f"{bad} quarantined"] * (bad > 0) + [f"{cut} truncated"] * (cut > 0)
    tiles = [(str(len(episodes)), "episodes", ", ".join(notes) or "all complete")]
    if content.activities is not None:
        hands = content.activities.select("episode_id", "hand").n_unique()
        tiles.append((str(content.activities.height), "activities", counted(hands, "hand track")))
    if cards:
        quarantined = sum(card.is_quarantined for card in cards)
        behind = sum(card.n_transitions for card in cards)
        note = f"from {counted(behind, 'transition')}" + (
            f", {quarantined} quarantined" if quarantined else ""
        )
        tiles.append((str(len(cards)), "operators", note))
    if content.domains:
        tiles.append((str(len(content.domains)), "domains", "named by the hash of their text"))
    if matrix is not None:
        solved, tried = (sum(pair[k] for pair in matrix.totals) for k in (0, 1))
        tiles.append((f"{solved}/{tried}", "plans", "found and validated"))
    return tiles
