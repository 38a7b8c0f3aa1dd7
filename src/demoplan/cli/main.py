"""The command ``demoplan``: its commands, and how errors end it."""

import os
import sys
from typing import Annotated

import typer

import demoplan
from demoplan.cli import data, domains, execution, exporting, planning, running, store, viewing
from demoplan.cli.output import Exit, fail, stderr
from demoplan.errors import DemoplanError, UsageError

app = typer.Typer(
    name="demoplan",
    help="From logged demonstrations of manipulation to planning domains that robots can use, with proof.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 fine, 1 failed, 2 wrong arguments, 3 finished, but data was lost or set aside.",
)
running.register(app)
data.register(app)
domains.register(app)
planning.register(app)
execution.register(app)
store.register(app)
viewing.register(app)
exporting.register(app)


def _show_version(is_asked: bool) -> None:
    if is_asked:
        typer.echo(f"demoplan {demoplan.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Say the version, and end."),
    ] = False,
) -> None:
    """From logged demonstrations of manipulation to planning domains that robots can use, with proof."""


def main() -> None:
    """Run the command line; errors raised on purpose end it with one message and a documented code."""
    try:
        app()
    except UsageError as error:
        fail(str(error), Exit.WRONG_ARGUMENTS)
    except DemoplanError as error:
        fail(str(error))
    except KeyboardInterrupt:
        stderr.print("stopped; what was finished is kept, run the same command again to go on")
        raise SystemExit(130) from None
    except BrokenPipeError:
        # The reader of our output went away, as `head` does: nothing is wrong.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(int(Exit.FINE)) from None
