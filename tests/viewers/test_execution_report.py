"""The page about runs: counts in every cell, what is shown as text, and readable without colours or a mouse."""

import re
from itertools import product

import pytest

from demoplan.pipeline.execution.execute import run_rows, step_rows
from demoplan.stages.score_runs import fault_confusion, score_runs
from demoplan.viewers.report.execution import fault_matrix, render_execution_report, run_matrices

HOSTILE = "<script>alert(1)</script>"


def run(number, *, domain="p1", goal="tower", fault=None, monitor="full", reached=True, **more):
    return {
        "run_id": f"r{number}",
        "domain_id": "d",
        "domain_name": domain,
        "goal": goal,
        "robot": "gripper",
        "monitor": monitor,
        "seed": number,
        "fault": fault,
        "fault_kind": fault,
        "fault_class": None if fault is None else "execution_offset",
        "severity": None if fault is None else "mild",
        "is_recoverable": None if fault is None else True,
        "is_fault_injected": fault is not None,
        "is_goal_reached": reached,
        "is_goal_sensed": reached,
        "outcome": "reached" if reached else "gave_up",
        "reason": None,
        "n_plans": 1,
        "n_steps": 4,
        "n_discrepancies": 0,
        "n_passed": 0,
        "n_false_alarms": 0,
        "n_unsound": 0,
        "diagnosed": None if fault is None else "execution_offset",
        "simulated_s": 20.0,
        **more,
    }


@pytest.fixture
def runs():
    clean = [
        run(k, domain=domain, goal=goal, reached=not (goal == "towers" and domain == "p2" and k % 2))
        for k, (domain, goal, _) in enumerate(product(("p1", "p2"), ("tower", "towers"), range(2)))
    ]
    faulty = [
        run(100 + k, fault="slip", monitor=monitor, reached=monitor == "full")
        for k, monitor in enumerate(("full", "full", "none"))
    ]
    return run_rows([*clean, *faulty])


def page_of(runs, title="runs"):
    return render_execution_report(title, runs, step_rows([]), score_runs(runs), fault_confusion(runs))


def test_a_cell_counts_the_runs_that_reached_the_goal_of_those_tried(runs):
    (matrix,) = run_matrices(runs)
    assert matrix.columns == ("p1", "p2")
    cells = {name: row for name, _, row in matrix.rows}
    assert cells["tower"] == ((2, 2, ""), (2, 2, ""))
    assert cells["towers"] == ((2, 2, ""), (1, 2, "gave up"))
    assert (matrix.totals, matrix.total) == (((4, 4), (3, 4)), (7, 8))


def test_runs_with_faults_are_counted_by_fault_and_monitor_and_nowhere_else(runs):
    matrix = fault_matrix(runs)
    assert matrix.columns == ("full", "none")
    assert matrix.rows == (("slip", (2, 3), ((2, 2, ""), (0, 1, "gave up"))),)
    assert fault_matrix(runs.filter(~runs["is_fault_injected"])) is None


def test_a_run_that_only_believes_in_its_goal_is_said_to():
    (matrix,) = run_matrices(run_rows([run(0, reached=False, outcome="reached")]))
    assert matrix.rows[0][2] == ((0, 1, "believed reached"),)


def test_the_page_has_no_script_asks_for_nothing_and_shows_names_as_text(runs):
    hostile = run_rows([run(0, domain=HOSTILE, goal=HOSTILE, reached=False, reason=HOSTILE)])
    for page in (page_of(runs), page_of(hostile, HOSTILE)):
        assert "<script" not in page
        assert not re.search(r"(?:src|href)=\"(?!#|data:)", page)
        assert "default-src 'none'" in page
    assert "&lt;script&gt;" in page_of(hostile, HOSTILE)


def test_every_column_says_what_it_is_and_every_wide_table_can_be_reached_by_keyboard(runs):
    page = page_of(runs)
    heads = re.findall(r"<th\b[^>]*>", page)
    assert heads
    assert all("scope=" in head for head in heads)
    assert not re.search(r"<th[^>]*></th>", page)
    regions = re.findall(r'<div class="scroll"[^>]*>', page)
    assert regions
    assert all('tabindex="0"' in region and "aria-label=" in region for region in regions)


def contrast(one, other):
    """Source: W3C, Web Content Accessibility Guidelines 2.1, 2018, "contrast ratio"."""

    def luminance(colour):
        parts = [int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)]
        linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    high, low = sorted((luminance(one), luminance(other)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_all_text_stands_out_from_what_it_stands_on_in_light_and_dark(runs):
    blocks = re.findall(r":root \{(.*?)\}", page_of(runs), flags=re.DOTALL)
    assert len(blocks) >= 2
    for block in blocks[:2]:
        colour = dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6});", block))
        for ink in ("ink", "soft", "accent", "good", "bad", "warn"):
            for ground in ("page", "card"):
                assert contrast(colour[ink], colour[ground]) >= 4.5, (ink, ground)
        for ink in ("good", "bad", "warn"):
            assert contrast(colour[ink], colour[f"{ink}-soft"]) >= 4.5, ink
