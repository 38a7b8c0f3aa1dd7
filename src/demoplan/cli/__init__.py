"""The command line: reads arguments, calls the pipeline, prints results; nothing else prints or exits."""

from demoplan.cli.main import main

__all__ = ["main"]
