"""The commands that let robots run plans, refusing what cannot be run."""

import pytest
from typer.testing import CliRunner

from demoplan.cli.main import app
from demoplan.errors import UnknownNameError


@pytest.fixture
def command(tmp_path):
    def run(*words):
        return CliRunner().invoke(app, [*words, "--store", str(tmp_path)])

    return run


def test_each_command_says_what_it_is_for():
    for name, word in (
        ("execute", "simulated robot"),
        ("evaluate", "every domain"),
        ("serve-goals", "rosbridge"),
    ):
        result = CliRunner().invoke(app, [name, "--help"], env={"COLUMNS": "200"})
        assert result.exit_code == 0
        assert word in result.stdout


@pytest.mark.parametrize(
    ("words", "kind"),
    [
        (("execute", "-d", "x", "-g", "onTop(a,b)", "--robot", "spot"), "robot"),
        (("execute", "-d", "x", "-g", "onTop(a,b)", "--monitor", "half"), "monitor"),
        (("execute", "-d", "x", "-g", "onTop(a,b)"), "domain"),
        (("serve-goals", "-d", "x", "--robot", "spot"), "robot"),
        (("evaluate", "cube-*", "--goals", "goals.yaml"), "domain"),
    ],
)
def test_what_does_not_exist_is_refused_with_what_does(command, words, kind):
    result = command(*words)
    assert isinstance(result.exception, UnknownNameError)
    assert result.exception.kind == kind
