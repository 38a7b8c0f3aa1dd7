"""The translator, kept warm: processes that have it loaded and run it anew for every task.

Half of what the translator takes for a small task goes into starting Python and importing. A process of
:mod:`demoplan.engines.fast_downward.preloading` does both once, and then forks for every task: each has
limits of its own, and leaves nothing to the next. After its first task it practises on a small one of ours,
which makes each later task faster. We never import the translator ourselves.

A task that does not end in time takes its process with it, and the next starts another. If the process itself
is gone, killed by somebody or never able to start, the task is translated in a process of its own.
"""

import atexit
import contextlib
import json
import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

from demoplan.engines.fast_downward import preloading
from demoplan.engines.fast_downward.installation import Installation
from demoplan.engines.fast_downward.processes import Ended, run_limited, tail

MODULE = "fast_downward.translate"
_PRACTICE = Path(__file__).parent / "practice"
"""A small task that has something of all that our domains use."""
_OUTPUT = "translator-output.txt"
_MOST_IDLE = 8
"""More processes than this are not kept, however many tasks were translated at once."""

CAN_BE_WARM = sys.platform == "linux"


def environment_of(installation: Installation) -> dict[str, str]:
    """All environment variables of a translator.

    It iterates over sets of strings: with a fixed hash seed, equal input gives equal tasks.
    """
    return {
        "PYTHONPATH": str(installation.translator_path),
        "PYTHONHASHSEED": "0",
        "PYTHONUTF8": "1",
        # It sets 10 MB aside, and touches them all: five large pages cost less than 2500 small ones.
        "GLIBC_TUNABLES": "glibc.malloc.hugetlb=1",
    }


def translate(
    arguments: Sequence[str | Path],
    *,
    folder: Path,
    installation: Installation,
    wall_s: float,
    memory_bytes: int | None,
) -> Ended:
    """Run the translator once, to its end or its limits.

    Args:
        arguments: Of its command line.
        folder: Working directory.
        installation: Where it is.
        wall_s: Wall-clock time that it may take [s]; its CPU time is limited to the next full second.
        memory_bytes: Address space that it may take.
    """
    start = time.monotonic()
    ended = _POOL.run(arguments, folder, installation, wall_s, memory_bytes) if CAN_BE_WARM else None
    if ended is not None:
        return ended
    left_s = wall_s - (time.monotonic() - start)
    return translate_cold(
        arguments, folder=folder, installation=installation, wall_s=left_s, memory_bytes=memory_bytes
    )


def translate_cold(
    arguments: Sequence[str | Path],
    *,
    folder: Path,
    installation: Installation,
    wall_s: float,
    memory_bytes: int | None,
) -> Ended:
    """The same in a process that is started for it."""
    # -S and -P: no site packages and no working directory on the module path; both cost time or trust.
    return run_limited(
        [sys.executable, "-S", "-P", "-m", MODULE, *arguments],
        folder=folder,
        environment=environment_of(installation),
        wall_s=wall_s,
        memory_bytes=memory_bytes,
    )


def practice_arguments() -> tuple[str, ...]:
    """What the translator is called with to practise; its task goes nowhere."""
    return ("--sas-file", os.devnull, str(_PRACTICE / "domain.pddl"), str(_PRACTICE / "problem.pddl"))


def close_translators() -> None:
    """End every process that is kept warm; the next task starts one again."""
    _POOL.close()


class _Warm:
    """One process with the translator loaded; one task at a time."""

    def __init__(self, installation: Installation) -> None:
        self.installation = installation
        self._process = subprocess.Popen(
            [sys.executable, "-S", "-P", preloading.__file__, MODULE, *practice_arguments()],
            env=environment_of(installation),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )

    @property
    def is_alive(self) -> bool:
        if self._process.returncode is not None:
            return False
        # It is not reaped, so that its number stays its own until its group has been signalled.
        options = os.WEXITED | os.WNOHANG | os.WNOWAIT
        return os.waitid(os.P_PID, self._process.pid, options) is None

    def run(
        self, arguments: Sequence[str | Path], folder: Path, wall_s: float, memory_bytes: int | None
    ) -> Ended | None:
        """One task; None if the process itself has ended. What does not end in time is ended with it."""
        start = time.monotonic()
        request = {
            "arguments": [str(each) for each in arguments],
            "folder": str(folder),
            "output": _OUTPUT,
            "cpu_s": max(1, math.ceil(wall_s)),
            "memory_bytes": memory_bytes,
        }
        try:
            answer = self._asked(json.dumps(request).encode() + b"\n", start + wall_s)
        except BaseException:
            self.end()
            raise
        if answer is None:
            self.end()
            if time.monotonic() < start + wall_s:
                return None
        log = folder / _OUTPUT
        return Ended(
            exit_code=-signal.SIGKILL if answer is None else int(json.loads(answer)["exit_code"]),
            is_timeout=answer is None,
            wall_s=time.monotonic() - start,
            output=tail(log) if log.exists() else "",
        )

    def _asked(self, request: bytes, deadline: float) -> bytes | None:
        assert self._process.stdin is not None
        try:
            self._process.stdin.write(request)
            self._process.stdin.flush()
        except BrokenPipeError:
            return None
        answer = self._answer(deadline)
        return answer if answer.endswith(b"\n") else None

    def _answer(self, deadline: float) -> bytes:
        """A line, if it comes in time; less than one if the process has ended or time is up."""
        assert self._process.stdout is not None
        descriptor = self._process.stdout.fileno()
        poller = select.poll()
        poller.register(descriptor, select.POLLIN | select.POLLHUP)
        answer = b""
        while not answer.endswith(b"\n"):
            left_s = deadline - time.monotonic()
            if left_s <= 0 or not poller.poll(math.ceil(left_s * 1e3)):
                break
            part = os.read(descriptor, 4096)
            if not part:
                break
            answer += part
        return answer

    def end(self) -> None:
        """End the process, and whatever it runs."""
        if self._process.returncode is not None:
            return
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with contextlib.suppress(BrokenPipeError):
                    stream.close()


class _Pool:
    """Warm processes that have nothing to do. Threads take one each, and give it back."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._idle: list[_Warm] = []
        self._owner = os.getpid()

    def run(
        self,
        arguments: Sequence[str | Path],
        folder: Path,
        installation: Installation,
        wall_s: float,
        memory_bytes: int | None,
    ) -> Ended | None:
        warm = self._take(installation)
        ended = warm.run(arguments, folder, wall_s, memory_bytes)
        self._give_back(warm)
        return ended

    def _take(self, installation: Installation) -> _Warm:
        with self._lock:
            if self._owner != os.getpid():
                # A copy of us: the processes are those of whom we are a copy of.
                self._idle, self._owner = [], os.getpid()
            while self._idle:
                warm = self._idle.pop()
                if warm.is_alive and warm.installation == installation:
                    return warm
                warm.end()
        return _Warm(installation)

    def _give_back(self, warm: _Warm) -> None:
        with self._lock:
            if warm.is_alive and len(self._idle) < _MOST_IDLE:
                self._idle.append(warm)
                return
        warm.end()

    def close(self) -> None:
        with self._lock:
            idle, self._idle = self._idle, []
        if self._owner == os.getpid():
            for warm in idle:
                warm.end()


_POOL = _Pool()
atexit.register(close_translators)
