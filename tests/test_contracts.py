"""What the repository publishes must match the code."""

import re
from pathlib import Path

import pytest

from demoplan.pipeline.contracts import contracts

CHECKOUT = Path(__file__).resolve().parent.parent


@pytest.mark.parametrize("name", sorted(contracts()))
def test_published_schemas_match_the_code(name):
    assert (CHECKOUT / "schemas" / name).read_text() == contracts()[name], "run `demoplan schemas`"


def test_no_schema_is_published_that_the_code_does_not_know():
    published = {
        p.relative_to(CHECKOUT / "schemas").as_posix() for p in (CHECKOUT / "schemas").rglob("*.json")
    }
    assert published == set(contracts())


def test_every_column_says_what_it_is_and_times_and_lengths_have_units():
    from demoplan import tables

    for name in tables.__all__:
        for column, declared in getattr(tables, name).columns().items():
            assert declared.description, f"{name}.{column}"
            for suffix, unit in (("_ns", "ns"), ("_m", "m")):
                if column.endswith(suffix):
                    assert (declared.metadata or {}).get("unit") == unit, f"{name}.{column}"


def test_the_readme_has_one_command_for_the_main_job_and_one_for_the_tests():
    commands = re.findall(r"^python3 -m venv .*$", (CHECKOUT / "README.md").read_text(), re.MULTILINE)
    assert len(commands) == 2
    assert "demoplan run datasets/cube-stacking" in commands[0]
    assert "pytest" in commands[1]


def test_links_of_the_readme_lead_somewhere():
    text = (CHECKOUT / "README.md").read_text()
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", text):
        assert (CHECKOUT / target).exists(), target


def test_commands_of_the_readme_exist():
    from demoplan.cli.main import app

    known = {command.name or command.callback.__name__ for command in app.registered_commands}
    known |= {group.name for group in app.registered_groups}
    text = (CHECKOUT / "README.md").read_text()
    asked = set(re.findall(r"^demoplan ([a-z-]+)", text, re.MULTILINE))
    assert asked
    assert asked <= known
