"""The report: complete from its tables, safe from their contents, the same bytes every time."""

import dataclasses
import re
from html.parser import HTMLParser

import polars as pl
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from demoplan import tables
from demoplan.viewers.report import DomainText, Picture, RefutedPlan, ReportContent, render_report
from demoplan.viewers.report.activity_bars import episode_bars
from demoplan.viewers.report.markup import ink_on, visible
from demoplan.viewers.report.pddl_text import coloured
from demoplan.viewers.report.plan_matrix import plan_matrix
from demoplan.viewers.report.scores import key_results, score_grid

HOSTILE = "\"><script>alert(1)</script><img src=x onerror='alert(2)'>{{ 7*7 }}\u202e&amp;"
VOID = {"meta", "img", "br", "rect", "line", "circle", "link", "input", "hr"}


class Page(HTMLParser):
    """Elements, attributes and text of a page; fails on elements that are not closed."""

    def __init__(self, html):
        super().__init__(convert_charrefs=True)
        self.tags, self.attributes, self.text, self.open = [], [], [], []
        self.feed(html)
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append(tag)
        self.attributes += [(tag, name, value) for name, value in attrs]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append(data)

    @property
    def words(self):
        return " ".join(" ".join(self.text).split())


@pytest.fixture(scope="module")
def html(report_content):
    return render_report(report_content)


@pytest.fixture(scope="module")
def page(html):
    return Page(html)


def _shuffled(content):
    names = [
        f.name for f in dataclasses.fields(content) if isinstance(getattr(content, f.name), pl.DataFrame)
    ]
    return dataclasses.replace(
        content, **{n: getattr(content, n).sample(fraction=1.0, shuffle=True, seed=3) for n in names}
    )


def test_the_same_tables_give_the_same_bytes_in_any_row_order(report_content, html):
    assert render_report(report_content) == html
    assert render_report(_shuffled(report_content)) == html


def test_the_page_needs_nothing_else_and_runs_nothing(page, html):
    assert "script" not in page.tags
    assert not {"link", "iframe", "object", "embed", "form"} & set(page.tags)
    assert not [a for a in page.attributes if a[1].startswith("on")]
    for _, name, value in page.attributes:
        if name in ("src", "href"):
            assert value.startswith(("#", "data:image/png;base64,"))
    assert not re.search(r"url\(|@import|https?://", html)


def test_every_section_that_has_a_table_is_there_and_reachable(page):
    ids = {value for _, name, value in page.attributes if name == "id"}
    links = {value[1:] for tag, name, value in page.attributes if (tag, name) == ("a", "href")}
    assert links <= ids
    assert {
        "results",
        "plans",
        "episodes",
        "activities",
        "segmentation",
        "operators",
        "domains",
        "failures",
    } <= ids


def test_episodes_alone_make_a_report(episodes):
    page = Page(render_report(ReportContent(dataset="bare", episodes=episodes)))
    ids = {value for _, name, value in page.attributes if name == "id"}
    # The failures come from the episodes themselves.
    assert ids == {"content", "episodes", "failures", "glossary"}


def test_types_to_split_stand_before_other_findings_with_what_became_of_them(report_content):
    finding = {
        "n_support": 20,
        "n_against": 0,
        "rate": None,
        "log10_bayes_factor": 3.0,
    }
    rows = [
        finding | {"kind": "exclusion", "subject": "g", "statement": "one holds", "is_applied": True},
        finding | {"kind": "type", "subject": "Toy: ball", "statement": "it <rolls>", "is_applied": False},
    ]
    findings = tables.Findings.validate(pl.DataFrame(rows, schema=tables.Findings.create_empty().schema))
    words = Page(render_report(dataclasses.replace(report_content, findings=findings))).words
    assert "type Toy: ball it <rolls> 10^3.0 proposed" in words
    assert words.index("Toy: ball") < words.index("exclusion g one holds 10^3.0 applied")


def test_a_quarantined_episode_is_told_with_its_reason_before_any_result(page):
    reason = "not a log: magic bytes are 'PK', expected MCAP, ROS bag or SQLite"
    assert reason in page.words
    assert page.words.index(reason) < page.words.index("Over everything that was scored")


def test_key_results_show_n_and_interval_and_what_they_are_held_against(page):
    assert "segmentation decision_tree frame_accuracy 0.978 0.958 – 0.993 24 0.874 AIJ 2017" in page.words


def test_key_results_keep_to_the_methods_used_but_the_comparison_shows_all(report_content):
    rows = key_results(report_content.scores, (), ("decision_tree",))
    assert {row.method for row in rows if row.suite == "segmentation"} == {"decision_tree"}
    assert {row.method for row in rows if row.suite == "planning"} == {"combined domain", "single domains"}
    assert {row.method for row in key_results(report_content.scores, ())} >= {"naive", "rule_tree"}
    grid = score_grid(report_content.scores, "segmentation")
    assert grid.methods == ("decision_tree", "naive", "rule_tree")
    assert score_grid(report_content.scores, "planning") is None


def test_each_literal_shows_its_support(page):
    assert "graspable(?hand, ?cube) 22/24" in page.words
    assert "¬ onTop(?cube, ?table) 15/15" in page.words or "¬onTop(?cube, ?table) 15/15" in page.words


def test_evidence_is_told_in_seconds_of_its_episode(page, report_content):
    first = (
        report_content.evidence.filter(pl.col("operator") == "reach_1").sort("start_ns").row(0, named=True)
    )
    start = report_content.episodes.filter(pl.col("episode_id") == first["episode_id"])["start_ns"][0]
    seconds = f"{(first['start_ns'] - start) * 1e-9:.2f}"
    assert f"{first['episode_id']} {first['hand']} {seconds}" in page.words


def test_the_matrix_counts_validated_plans_only(report_content):
    plans = report_content.plans.with_columns(
        is_validated=pl.when(pl.col("domain_id") == f"{3:016x}").then(False).otherwise(pl.col("is_validated"))
    )
    matrix = plan_matrix(plans, report_content.domains, report_content.goals)
    by_name = dict(zip(matrix.domains, matrix.totals, strict=True))
    assert matrix.domains[0] == "combined"
    assert by_name["p1-3"] == (0, 4)
    assert by_name["p1-0"] == (4, 4)
    assert next(goal for goal, *_ in matrix.rows) == "one on one"
    assert {c[matrix.domains.index("p1-3")].outcome for _, c, _, _ in matrix.rows} == {"not validated"}


def test_a_later_attempt_that_succeeds_counts(report_content):
    row = report_content.plans.filter(pl.col("outcome") == "unsolvable")
    better = row.with_columns(
        attempt=pl.lit(1, dtype=pl.Int64),
        outcome=pl.lit("solved").cast(row.schema["outcome"]),
        is_validated=pl.lit(True),
        n_steps=pl.lit(5, dtype=pl.Int64),
    )
    matrix = plan_matrix(pl.concat([report_content.plans, better]), report_content.domains, ())
    cells = [c for _, cells, _, _ in matrix.rows for c in cells if c.n_attempts == 2]
    assert [(c.is_solved, c.n_steps) for c in cells] == [(True, 5)]


def test_a_plan_that_could_not_happen_is_not_solved_and_says_why(report_content):
    goal = report_content.goals[0][0]
    refuted = RefutedPlan(
        domain_id=f"{12:016x}", goal=goal, cause="step 2 takes cube_red from under cube_blue"
    )
    matrix = plan_matrix(report_content.plans, report_content.domains, report_content.goals, (refuted,))
    assert matrix.totals[0] == (3, 4)
    words = Page(render_report(dataclasses.replace(report_content, refuted=(refuted,)))).words
    assert "plan one on one with combined impossible: step 2 takes cube_red from under cube_blue" in words


def test_suites_without_a_total_show_what_they_have_and_bare_figures_stay_in_the_comparison(report_content):
    bare = {"low": None, "high": None, "metric": "f1 Reach"}
    scores = report_content.scores
    extra = scores.filter(pl.col("metric") == "edit").with_columns(
        pl.lit(v, dtype=scores.schema[k]).alias(k) for k, v in bare.items()
    )
    planning = scores.filter(pl.col("suite") == "planning").with_columns(subject=pl.lit("fresh domains"))
    rest = scores.filter(pl.col("suite") != "planning")
    rows = key_results(pl.concat([rest, extra, planning]), ())
    assert {row.subject for row in rows if row.suite == "planning"} == {"fresh domains"}
    assert "f1 Reach" not in {row.metric for row in rows}
    broken_down = planning.with_columns(metric=pl.concat_str(pl.lit("solved: "), pl.col("metric")))
    assert not [row for row in key_results(broken_down, ()) if row.metric.startswith("solved")]
    assert "f1 Reach" in dict(score_grid(pl.concat([rest, extra]), "segmentation").rows)


def test_every_failure_is_a_row_with_its_cause(page):
    for cause in (
        "truncated: the log ends within a chunk; 1933 of 2000 messages kept",
        "7 of 3000 messages rejected: position holds NaN",
        "tower in an order never shown with p2-0 unsolvable: no operator makes clear(cube_red) true",
        "one Take missed: 0.04 s long",
    ):
        assert cause in page.words


def test_agreement_beside_the_bars_is_the_share_of_time_with_equal_names(activities, truth):
    (bars,) = episode_bars(activities, truth)
    grid = range(truth["start_ns"].min(), truth["end_ns"].max(), 10_000_000)
    for hand in bars.hands:
        names = []
        for table in (activities, truth):
            rows = table.filter(pl.col("hand") == hand.hand).sort("start_ns")
            at = rows["start_ns"].search_sorted(pl.Series(grid), side="right") - 1
            names.append(rows["activity"].gather(at))
        assert hand.agreement == pytest.approx((names[0] == names[1]).mean())


def test_bars_without_truth_claim_no_agreement(activities):
    (bars,) = episode_bars(activities, None)
    assert [hand.agreement for hand in bars.hands] == [None, None]
    assert "differs" not in bars.hands[0].svg


def _hostile(content):
    """The same content with a hostile text in every column that holds text of others."""
    free = {
        "episodes": ("dataset", "file", "participant", "task", "reason"),
        "topics": ("topic", "message_type", "note"),
        "activities": ("hand", "activity", "acted_on"),
        "truth": ("hand", "activity", "acted_on"),
        "scores": ("method", "metric"),
        "operators": ("activity", "note"),
        "literals": ("predicate", "note"),
        "evidence": ("hand",),
        "plans": ("goal", "message"),
    }
    changed = {}
    for name, columns in free.items():
        table = getattr(content, name)
        changed[name] = table.with_columns(
            pl.when(pl.col(c).is_not_null()).then(pl.concat_str(pl.lit(HOSTILE), pl.col(c))).alias(c)
            for c in columns
        )
    changed["domains"] = (DomainText(domain_id=HOSTILE, name=HOSTILE, text=f"; {HOSTILE}\n({HOSTILE})"),)
    changed["goals"] = ((HOSTILE, HOSTILE),)
    changed["pictures"] = (Picture(caption=HOSTILE, png=b"\x89PNG"),)
    return dataclasses.replace(
        content, dataset=HOSTILE, description=HOSTILE, versions=((HOSTILE, HOSTILE),), **changed
    )


def test_hostile_names_are_shown_and_never_run(report_content, html):
    hostile = render_report(_hostile(report_content))
    page = Page(hostile)
    assert "script" not in page.tags
    assert page.tags.count("img") == 1  # our own picture
    assert not [a for a in page.attributes if a[1].startswith("on")]
    assert "\u202e" not in hostile
    assert "{{ 7*7 }}" in page.words
    assert "&amp;" in page.words


@settings(max_examples=60, deadline=None)
@given(st.text())
def test_any_text_stays_text(name):
    episodes = tables.Episodes.validate(
        pl.DataFrame(
            {
                "episode_id": ["e"],
                "dataset": ["d"],
                "file": [name.encode("utf-8", "replace").decode()],
                "sha256": [None],
                "participant": ["p"],
                "task": [name.encode("utf-8", "replace").decode()],
                "is_goal_reached": [None],
                "status": ["complete"],
                "reason": [None],
                "start_ns": [None],
                "end_ns": [None],
            }
        ),
        cast=True,
    )
    plain = Page(
        render_report(
            ReportContent(dataset="d", episodes=episodes.with_columns(file=pl.lit("x"), task=pl.lit("x")))
        )
    )
    page = Page(render_report(ReportContent(dataset="d", episodes=episodes)))
    assert page.tags == plain.tags
    assert "\x00" not in page.words


@settings(deadline=None)
@given(st.text(alphabet=st.characters(codec="utf-8")))
def test_colouring_never_changes_the_text(pddl):
    assert "".join(Page(str(coloured(pddl))).text) == visible(pddl)


@settings(deadline=None)
@given(st.tuples(*[st.integers(0, 255)] * 3))
def test_ink_keeps_enough_contrast_on_any_colour(colour):
    def luminance(rgb):
        parts = [c / 255 / 12.92 if c <= 10 else ((c / 255 + 0.055) / 1.055) ** 2.4 for c in rgb]
        return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2]

    ink = (17, 17, 17) if ink_on(colour) == "#111" else (255, 255, 255)
    low, high = sorted((luminance(ink), luminance(colour)))
    assert (high + 0.05) / (low + 0.05) > 4.0


def test_a_missing_figure_is_a_dash_not_nan(report_content):
    scores = report_content.scores.with_columns(value=pl.lit(None, dtype=pl.Float64))
    words = Page(render_report(dataclasses.replace(report_content, scores=scores))).words
    assert "frame_accuracy –" in words
    assert not re.search(r"\bnan\b", words)
