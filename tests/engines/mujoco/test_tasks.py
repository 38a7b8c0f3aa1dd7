import pytest

pytest.importorskip("mujoco")

from demoplan.engines.mujoco.tasks import _NAMED, STUDY_TASKS, Step, parse_task
from demoplan.errors import UnknownNameError, UsageError


def test_the_study_stacks_one_and_two_cubes_with_either_hand():
    tasks = [parse_task(name) for name in STUDY_TASKS]
    assert [len(task.steps) for task in tasks] == [1, 1, 2, 2]
    assert [task.hand for task in tasks] == ["Left_hand", "Right_hand"] * 2


def test_a_task_can_be_spelled_out():
    task = parse_task("mine: red>blue, green>red@left; start yellow>orange; cubes 5")
    assert task.steps == (
        Step("cube_red", "cube_blue", "Right_hand"),
        Step("cube_green", "cube_red", "Left_hand"),
    )
    assert task.start == (("cube_yellow", "cube_orange"),)
    assert task.n_cubes == 5
    assert task.hand is None


def test_every_named_task_can_be_done():
    for what in _NAMED:
        task = parse_task(f"{what}-left")
        moves = ", ".join(f"{step.cube}>{step.onto}" for step in task.steps)
        start = ", ".join(f"{cube}>{onto}" for cube, onto in task.start)
        spelled = f"spelled: {moves}" + (f"; start {start}" if start else "") + f"; cubes {task.n_cubes}"
        assert parse_task(spelled).goal == task.goal


def test_the_goal_is_where_each_cube_was_put_last():
    assert parse_task("a: red>blue, red>table").goal == (("cube_red", "table"),)


@pytest.mark.parametrize(
    ("text", "error", "words"),
    [
        ("one-middle", UnknownNameError, ["one-middle", "one-left", "two-right"]),
        ("a: red>pink", UnknownNameError, ["pink", "red", "table"]),
        ("a: red>red", UsageError, ["red>red"]),
        ("a: table>red", UsageError, ["table>red"]),
        ("a: red", UsageError, ["cube>onto"]),
        ("../a: red>blue", UsageError, ["../a"]),
        ("a: red>blue; stop", UsageError, ["stop", "start"]),
        ("a: red>blue, green>blue", UsageError, ["cube_red is on cube_blue"]),
        ("a: red>blue; start green>red", UsageError, ["cube_green is on cube_red"]),
        ("a: red>table; start red>blue, green>blue", UsageError, ["both on cube_blue"]),
        ("a: red>orange", UnknownNameError, ["cube_orange", "cube_yellow"]),
    ],
)
def test_a_text_that_is_no_task_is_refused_with_what_would_be(text, error, words):
    with pytest.raises(error) as caught:
        parse_task(text)
    for word in words:
        assert word in str(caught.value)
