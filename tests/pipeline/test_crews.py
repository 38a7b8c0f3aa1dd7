"""Processes that die cost nothing but their own order."""

import importlib
import sys

import pytest

from demoplan.pipeline.crews import Processes

WORK = """
import os
from pathlib import Path


def work(order):
    word, folder = order
    once = Path(folder) / word
    if word == "always" or (word == "once" and not once.exists()):
        once.touch()
        os.kill(os.getpid(), 9)
    return word.upper()
"""


@pytest.fixture
def work(tmp_path, monkeypatch):
    """A function that other processes can import, and that kills some of them."""
    (tmp_path / "dying_work.py").write_text(WORK)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("dying_work").work
    sys.modules.pop("dying_work")


def test_an_order_that_kills_its_process_is_given_up_and_every_other_is_done(work, tmp_path):
    words = ["a", "always", "b", "once", "c", "d"]
    done = {order[0]: result for order, result in Processes(2)(work, [(w, str(tmp_path)) for w in words])}
    assert done == {w: w.upper() for w in words} | {"always": None}


def test_one_process_is_this_one_and_starts_no_other(tmp_path):
    assert [*Processes(1)(str.upper, ["a", "b"])] == [("a", "A"), ("b", "B")]
    assert [*Processes(2)(str.upper, [])] == []


def test_an_error_of_the_work_is_raised_and_not_taken_for_a_death():
    with pytest.raises(ValueError, match="invalid literal"):
        list(Processes(2)(int, ["1", "x", "2"]))
