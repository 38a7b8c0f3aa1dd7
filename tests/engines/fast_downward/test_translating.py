"""The translator kept warm: every task as if it were the only one, with limits of its own, and nothing left."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from demoplan.engines.fast_downward import Installation, close_translators, translating
from demoplan.engines.fast_downward.translating import translate, translate_cold
from demoplan.language.pddl import render_domain, render_problem

pytestmark = pytest.mark.skipif(not translating.CAN_BE_WARM, reason="no process is kept warm here")


@pytest.fixture(autouse=True)
def cold_start():
    close_translators()
    yield
    close_translators()


@pytest.fixture
def fake(tmp_path):
    """Makes a translator of a few lines; with a function that runs it in a folder of its own."""
    package = tmp_path / "path" / "fast_downward" / "translate"
    package.mkdir(parents=True)
    for folder in (package, package.parent):
        (folder / "__init__.py").touch()
    number = iter(range(1000))

    def make(source):
        (package / "__main__.py").write_text(f"import state\nif __name__ == '__main__':\n    {source}\n")
        (tmp_path / "path" / "state.py").write_text("seen = []\n")
        installation = Installation(search=tmp_path, translator_path=tmp_path / "path", version=source)

        def run(*arguments, wall_s=20.0, memory_bytes=None):
            folder = tmp_path / f"task-{next(number)}"
            folder.mkdir()
            return translate(
                arguments, folder=folder, installation=installation, wall_s=wall_s, memory_bytes=memory_bytes
            )

        return run

    return make


def warm_processes():
    """Numbers of all processes that run the program which keeps modules loaded, for this process."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            command = (entry / "cmdline").read_bytes()
            state, parent = (entry / "stat").read_text().rsplit(")", 1)[1].split()[:2]
        except (FileNotFoundError, ProcessLookupError):
            continue
        if b"preloading.py" in command and state != "Z" and int(parent) == os.getpid():
            found.append(int(entry.name))
    return found


def test_a_warm_translator_writes_the_same_task_as_a_cold_one(planner, stacking, towers, tmp_path):
    tasks = []
    for goal in ("onTop(a, b)", "onTop(a, b) & onTop(b, c)", "onTop(a, b)"):
        problem = towers(["a"], ["b"], ["c"], goal=goal)
        for how in (translate, translate_cold):
            folder = tmp_path / f"{len(tasks)}"
            folder.mkdir()
            (folder / "domain.pddl").write_text(render_domain(stacking))
            (folder / "problem.pddl").write_text(render_problem(problem, stacking))
            ended = how(
                ["--sas-file", "task.sas", "domain.pddl", "problem.pddl"],
                folder=folder,
                installation=planner,
                wall_s=30.0,
                memory_bytes=2 * 1024**3,
            )
            assert ended.exit_code == 0
            assert "Translator operators" in ended.output
            tasks.append((folder / "task.sas").read_bytes())
    assert tasks[0] == tasks[1] == tasks[4] == tasks[5]
    assert tasks[2] == tasks[3] != tasks[0]
    assert len(warm_processes()) == 1


def test_one_task_leaves_nothing_to_the_next(fake):
    run = fake("import os, sys; state.seen.append(1); print(state.seen, sys.argv[1:], os.getcwd()[-6:])")
    first, second = run("a"), run("b")
    assert (first.exit_code, first.output) == (0, "[1] ['a'] task-0\n")
    assert second.output == "[1] ['b'] task-1\n"


def test_practice_changes_nothing_that_a_later_task_can_see(fake):
    see = "print(state.seen, getattr(state, 'n', 0), sys.argv[1:], sys.stdin.read() == '')"
    run = fake(
        f"import sys; {see}; state.n = 1; state.seen.append(sys.argv[1]); state.seen = state.seen + [0]"
    )
    said = [run("a").output for _ in range(3)]
    assert said == ["[] 0 ['a'] True\n"] * 3
    assert len(warm_processes()) == 1


def test_practice_comes_once_and_only_after_a_task_that_went_well(fake, tmp_path):
    run = fake(
        "import sys; "
        f"open({str(tmp_path / 'practised')!r}, 'a').write('x' * (sys.argv[1] == '--sas-file')); "
        "raise SystemExit(int(sys.argv[1] == 'bad'))"
    )

    def n_practised():
        return len((tmp_path / "practised").read_text())

    assert run("bad").exit_code == 1
    assert run("bad").exit_code == 1
    assert n_practised() == 0
    for _ in range(3):
        assert run("good").exit_code == 0
    assert n_practised() == 1


def test_practice_that_fails_harms_nobody(fake):
    run = fake("import sys; 1 / (sys.argv[1] != '--sas-file'); print('done')")
    assert [run("a").output for _ in range(3)] == ["done\n"] * 3
    assert len(warm_processes()) == 1


def test_the_task_for_practice_can_be_translated(planner, tmp_path):
    ended = translate_cold(
        translating.practice_arguments(),
        folder=tmp_path,
        installation=planner,
        wall_s=30.0,
        memory_bytes=None,
    )
    assert ended.exit_code == 0
    assert "No relaxed solution" not in ended.output


@pytest.mark.parametrize(
    ("source", "exit_code", "said"),
    [
        ("raise SystemExit(31)", 31, ""),
        ("raise SystemExit('no such file')", 1, "no such file"),
        ("raise SystemExit", 0, ""),
        ("print(1 / 0)", 1, "ZeroDivisionError"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGKILL)", -9, ""),
        ("import os, sys; print(sys.stdin.read() == ''); os._exit(4)", 4, ""),
    ],
)
def test_an_end_is_told_as_it_was(fake, source, exit_code, said):
    ended = fake(source)()
    assert (ended.exit_code, ended.is_timeout) == (exit_code, False)
    assert said in ended.output


def test_a_task_that_takes_too_long_is_ended_and_the_next_one_is_not_harmed(fake):
    run = fake("import sys, time; print('begun', flush=True); time.sleep(float(sys.argv[1]))")
    assert not run("0").is_timeout
    (before,) = warm_processes()
    late = run("60", wall_s=0.5)
    assert late.is_timeout
    assert late.wall_s < 5
    assert late.output == "begun\n"
    assert not run("0").is_timeout
    assert before not in warm_processes()


def test_memory_and_processor_time_are_limited_for_each_task_alone(fake):
    run = fake(
        "import resource, sys; print(resource.getrlimit(resource.RLIMIT_CPU)); bytearray(int(sys.argv[1]))"
    )
    ended = run("400000000", memory_bytes=200_000_000, wall_s=5.5)
    assert ended.exit_code == 1
    assert "MemoryError" in ended.output
    assert ended.output.startswith("(6, 8)")
    assert run("400000000").exit_code == 0


def test_a_warm_process_that_was_killed_is_not_missed(fake):
    run = fake("print('done')")
    assert run().output == "done\n"
    (number,) = warm_processes()
    os.kill(number, signal.SIGKILL)
    assert run().output == "done\n"


def test_a_warm_process_that_is_killed_in_the_middle_costs_time_and_nothing_else(fake):
    run = fake("import time; time.sleep(0.6); print('done')")
    threading.Timer(0.3, lambda: [os.kill(each, signal.SIGKILL) for each in warm_processes()]).start()
    assert run().output == "done\n"


def test_a_translator_that_cannot_be_loaded_says_why(fake):
    ended = fake("pass\nimport no_such_module")()
    assert ended.exit_code == 1
    assert "no_such_module" in ended.output


def test_tasks_in_threads_do_not_wait_for_each_other(fake):
    run = fake("import sys, time; time.sleep(0.4); raise SystemExit(int(sys.argv[1]))")
    codes = {}

    def one(number):
        codes[number] = run(str(number)).exit_code

    threads = [threading.Thread(target=one, args=(number,)) for number in range(4)]
    start = time.monotonic()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert codes == {number: number for number in range(4)}
    assert time.monotonic() - start < 4 * 0.4 + 3
    assert len(warm_processes()) == 4


def test_closing_ends_every_process(fake):
    run = fake("pass")
    run()
    assert warm_processes()
    close_translators()
    assert not warm_processes()


def test_an_interrupt_leaves_no_process_behind(fake, tmp_path):
    fake("import time; time.sleep(300)")
    script = (
        "import sys\nfrom pathlib import Path\n"
        "from demoplan.engines.fast_downward import Installation\n"
        "from demoplan.engines.fast_downward.translating import translate\n"
        "path = Path(sys.argv[1])\n"
        "print('begin', flush=True)\n"
        "translate([], folder=path, installation=Installation(path, path / 'path', '0'), wall_s=60.0, "
        "memory_bytes=None)\n"
    )
    source = Path(__file__).parents[3] / "src"
    caller = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path)],
        env={**os.environ, "PYTHONPATH": str(source)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        caller.stdout.readline()
        end = time.monotonic() + 20
        children = []
        while not children and time.monotonic() < end:
            time.sleep(0.05)
            children = [
                int(entry.name)
                for entry in Path("/proc").glob("[0-9]*")
                if is_descendant(int(entry.name), caller.pid) and int(entry.name) != caller.pid
            ]
            children = children if len(children) >= 2 else []
        assert children
        caller.send_signal(signal.SIGINT)
        _, error = caller.communicate(timeout=20)
        assert b"KeyboardInterrupt" in error
        end = time.monotonic() + 5
        while any(map(is_running, children)) and time.monotonic() < end:
            time.sleep(0.02)
        assert not [each for each in children if is_running(each)]
    finally:
        caller.kill()
        caller.communicate()


def is_running(number):
    try:
        return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def is_descendant(number, ancestor):
    while number > 1:
        if number == ancestor:
            return True
        try:
            number = int(Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[1])
        except (FileNotFoundError, ProcessLookupError):
            return False
    return False
