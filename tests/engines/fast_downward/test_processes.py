"""Nothing outlives its limits: no orphans after a timeout, an exception or an interrupt."""

import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from demoplan.engines.fast_downward.processes import run_limited

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="process groups are read from /proc")

# A program that starts a child of its own, which ignores polite signals, and tells both numbers.
FAMILY = """
import os, subprocess, sys, time
child = subprocess.Popen([sys.executable, "-c", "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(300)"])
open("numbers.txt.part", "w").write(f"{os.getpid()} {child.pid}")
os.rename("numbers.txt.part", "numbers.txt")
"""


def is_alive(number):
    try:
        state = Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0]
    except (FileNotFoundError, ProcessLookupError):
        return False
    return state != "Z"


def all_gone(numbers, wait_s=5.0):
    end = time.monotonic() + wait_s
    while any(map(is_alive, numbers)):
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def run(folder, source, **limits):
    settings = {"wall_s": 20.0, "memory_bytes": None} | limits
    return run_limited([sys.executable, "-S", "-c", source], folder=folder, environment={}, **settings)


def test_a_program_that_ends_is_reported_as_it_ended(tmp_path):
    ended = run(tmp_path, "print('hello'); raise SystemExit(7)")
    assert (ended.exit_code, ended.is_timeout, ended.output) == (7, False, "hello\n")


def test_a_timeout_kills_the_whole_family(tmp_path):
    ended = run(tmp_path, FAMILY + "time.sleep(300)", wall_s=1.5)
    numbers = [int(each) for each in (tmp_path / "numbers.txt").read_text().split()]
    assert ended.is_timeout
    assert ended.wall_s < 5
    assert all_gone(numbers)


def test_a_program_that_ends_leaves_no_children_behind(tmp_path):
    ended = run(tmp_path, FAMILY + "sys.exit(3)")
    numbers = [int(each) for each in (tmp_path / "numbers.txt").read_text().split()]
    assert ended.exit_code == 3
    assert all_gone(numbers)


def test_an_interrupt_kills_the_whole_family(tmp_path):
    script = (
        "import sys\nfrom pathlib import Path\n"
        "from demoplan.engines.fast_downward.processes import run_limited\n"
        "run_limited([sys.executable, '-S', '-c', sys.argv[2]], folder=Path(sys.argv[1]), environment={}, "
        "wall_s=300, memory_bytes=None)\n"
    )
    source = Path(__file__).parents[3] / "src"
    caller = subprocess.Popen(
        [sys.executable, "-c", script, str(tmp_path), FAMILY + "time.sleep(300)"],
        env={**os.environ, "PYTHONPATH": str(source)},
        stderr=subprocess.PIPE,
        start_new_session=True,
    )
    try:
        end = time.monotonic() + 20
        while not (tmp_path / "numbers.txt").exists() and time.monotonic() < end:
            time.sleep(0.02)
        numbers = [int(each) for each in (tmp_path / "numbers.txt").read_text().split()]
        assert all(map(is_alive, numbers))
        caller.send_signal(signal.SIGINT)
        _, error = caller.communicate(timeout=20)
        assert b"KeyboardInterrupt" in error
        assert all_gone(numbers)
    finally:
        caller.kill()
        caller.communicate()


def test_processor_time_is_limited_even_without_us(tmp_path):
    source = "import resource, time; time.sleep(0.3); print(resource.getrlimit(resource.RLIMIT_CPU))"
    assert run(tmp_path, source, wall_s=2.5).output == "(3, 5)\n"


def test_memory_is_limited(tmp_path):
    ended = run(tmp_path, "import time; time.sleep(0.3); bytearray(400_000_000)", memory_bytes=200_000_000)
    assert ended.exit_code == 1
    assert "MemoryError" in ended.output


def test_long_output_is_kept_at_its_end_only(tmp_path):
    ended = run(tmp_path, "print('x' * 1_000_000); print('the end')")
    assert len(ended.output) <= 65_536
    assert ended.output.endswith("the end\n")


def test_programs_run_in_threads_without_disturbing_each_other(tmp_path):
    codes = {}

    def one(number):
        folder = tmp_path / str(number)
        folder.mkdir()
        codes[number] = run(folder, f"raise SystemExit({number})").exit_code

    threads = [threading.Thread(target=one, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert codes == {number: number for number in range(4)}
