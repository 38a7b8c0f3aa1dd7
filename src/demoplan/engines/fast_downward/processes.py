"""Programs that may run too long: each in a process group of its own, with limits, and never left behind."""

import contextlib
import math
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

if sys.platform != "win32":
    import resource

_TAIL_BYTES = 65_536


@dataclass(frozen=True)
class Ended:
    """How a program ended. ``exit_code`` is negative for a signal, as in :mod:`subprocess`."""

    exit_code: int
    is_timeout: bool
    """We ended it, since its wall-clock time was up."""
    wall_s: float
    output: str
    """The last 64 KiB of what it printed, both streams."""


def run_limited(
    command: Sequence[str | Path],
    *,
    folder: Path,
    environment: Mapping[str, str],
    wall_s: float,
    memory_bytes: int | None,
    stdin: Path | None = None,
) -> Ended:
    """Run a program to its end or its limits, whichever comes first.

    The program leads a session of its own. Whatever ends the wait (time, an exception, Ctrl-C), its whole
    process group is killed before this function is left. Should we ourselves be killed outright, its limit on
    CPU time still ends it. The limits are set on the running process from outside, since code between fork
    and exec is not safe in a program with threads.

    Args:
        command: Program and arguments.
        folder: Working directory; ``output.txt`` in it takes what the program prints.
        environment: All of its environment variables.
        wall_s: Wall-clock time that it may take [s]; its CPU time is limited to the next full second.
        memory_bytes: Address space that it may take; None for no limit. Not enforced outside of Linux.
        stdin: File that it reads from; nothing by default.
    """
    log = folder / "output.txt"
    start = time.monotonic()
    is_timeout = False
    with log.open("wb") as output, (stdin or Path(os.devnull)).open("rb") as source:
        process = subprocess.Popen(
            [str(part) for part in command],
            cwd=folder,
            env=dict(environment),
            stdin=source,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            _limit(process.pid, wall_s, memory_bytes)
            is_timeout = not _has_ended(process, wall_s)
        finally:
            _kill_group(process)
    return Ended(
        exit_code=process.returncode,
        is_timeout=is_timeout,
        wall_s=time.monotonic() - start,
        output=tail(log),
    )


def _limit(pid: int, wall_s: float, memory_bytes: int | None) -> None:
    if sys.platform != "linux":
        return
    with contextlib.suppress(ProcessLookupError):  # it may have ended already
        soft = max(1, math.ceil(wall_s))
        # At the soft limit Fast Downward is told and ends in order; at the hard limit the kernel ends it.
        resource.prlimit(pid, resource.RLIMIT_CPU, (soft, soft + 2))
        if memory_bytes is not None:
            resource.prlimit(pid, resource.RLIMIT_AS, (memory_bytes, memory_bytes))


def _has_ended(process: subprocess.Popen[bytes], wall_s: float) -> bool:
    """Whether the program ends within a time. On Linux it is not reaped, so that its number stays its own."""
    if sys.platform == "linux":
        descriptor = os.pidfd_open(process.pid)
        try:
            poller = select.poll()
            poller.register(descriptor, select.POLLIN)
            return bool(poller.poll(wall_s * 1000))
        finally:
            os.close(descriptor)
    try:
        process.wait(timeout=wall_s)
    except subprocess.TimeoutExpired:
        return False
    return True


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    # A descendant keeps the group alive after its leader has ended, so the group is signalled in every case;
    # a leader that has ended keeps its exit code.
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()


def tail(path: Path) -> str:
    """The last 64 KiB of a file, as text."""
    with path.open("rb") as file:
        file.seek(0, os.SEEK_END)
        file.seek(max(0, file.tell() - _TAIL_BYTES))
        return file.read().decode("utf-8", errors="replace")
