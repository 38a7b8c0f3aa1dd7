"""Runs of robots as Prefect artifacts: how often each domain reached each goal, and where the page is."""

from prefect.artifacts import acreate_table_artifact

from demoplan.pipeline.execution.evaluate import Evaluation
from demoplan.viewers.report.execution import run_matrices
from flows.showing import key_of, show_report


async def show_runs(dataset: str, robot: str, evaluation: Evaluation, report: str) -> None:
    """Domain × goal: how many runs reached it; and a link to the page about all of them."""
    await acreate_table_artifact(
        key=key_of("simulated", dataset, robot),
        table=runs_matrix(evaluation),
        description=f"{dataset} on {robot}: {evaluation.runs.height} runs, goals reached by physics",
    )
    await show_report(key_of("simulated-report", dataset, robot), report)


def runs_matrix(evaluation: Evaluation) -> list[dict[str, str]]:
    """One row per domain, one column per goal: reached of tried, and why others were missed."""
    rows: dict[str, dict[str, str]] = {}
    for matrix in run_matrices(evaluation.runs):
        for goal, _, cells in matrix.rows:
            for domain, cell in zip(matrix.columns, cells, strict=True):
                if cell is not None:
                    reached, tried, why = cell
                    text = f"{reached} of {tried}" + (f": {why}" if why else "")
                    rows.setdefault(domain, {"domain": domain})[goal] = text
    return [rows[name] for name in sorted(rows)]
