"""What we render is read by the other readers of PDDL that robotics people use."""

import pytest

from demoplan.language.pddl import parse_domain, parse_problem

pytest.importorskip("pddl", reason="the pddl package is not installed")
pytest.importorskip("unified_planning", reason="unified-planning is not installed")


@pytest.mark.parametrize("name", ["stacking-domain.pddl", "stacking-domain-plain.pddl"])
def test_pddl_reads_the_domain(golden_folder, name):
    from pddl import parse_domain as read

    domain = read(str(golden_folder / name))
    ours = parse_domain((golden_folder / name).read_text())
    assert len(domain.actions) == len(ours.operators)
    assert len(domain.predicates) == len(ours.predicates)


def test_pddl_reads_the_problem(golden_folder):
    from pddl import parse_problem as read

    problem = read(str(golden_folder / "stacking-problem.pddl"))
    ours = parse_problem(
        (golden_folder / "stacking-problem.pddl").read_text(),
        parse_domain((golden_folder / "stacking-domain.pddl").read_text()),
    )
    assert len(problem.objects) == len(ours.objects)


@pytest.mark.filterwarnings("default")
def test_unified_planning_reads_domain_and_problem(golden_folder):
    from unified_planning.io import PDDLReader

    problem = PDDLReader().parse_problem(
        str(golden_folder / "stacking-domain.pddl"), str(golden_folder / "stacking-problem.pddl")
    )
    ours = parse_domain((golden_folder / "stacking-domain.pddl").read_text())
    assert {action.name for action in problem.actions} == {
        operator.name.lower() for operator in ours.operators
    }
    costs = {action.name: cost.constant_value() for action, cost in problem.quality_metrics[0].costs.items()}
    assert costs == {operator.name.lower(): operator.cost for operator in ours.operators}
