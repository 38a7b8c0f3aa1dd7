"""A program of its own: keeps a Python package loaded, and runs it anew, in a fork, for every request.

Started as ``python preloading.py PACKAGE``, it does what ``python -m PACKAGE`` does, less the time that
starting and importing take. Requests and answers are lines of JSON on its own input and output; it ends when
its input ends. A fork is safe here, and only here: this process has one thread and imports nothing else.

A request: ``arguments``, ``folder`` (working directory), ``output`` (file that takes what is printed),
``cpu_s`` (limit on processor time, whole seconds) and ``memory_bytes`` (limit on address space, or null). An
answer: ``exit_code``, negative for a signal.
"""

import gc
import importlib
import json
import os
import resource
import runpy
import sys
import traceback
from typing import Any, TextIO

_CPU_GRACE_S = 2
"""After the soft limit the package may end in order; so much later the kernel ends it [s]."""


def main() -> None:
    """Load, then answer requests to the end of the input."""
    package = sys.argv[1]
    # What modules print while they are loaded, or a fork at any time, must not look like an answer.
    answers = os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 1)
    # This imports all that it will need; run it is anew each time, and as the main module.
    importlib.import_module(f"{package}.__main__")
    del sys.modules[f"{package}.__main__"]
    # Collecting garbage in a fork would copy every page that it looks at.
    gc.collect()
    gc.freeze()
    for line in sys.stdin:
        request = json.loads(line)
        child = os.fork()
        if child == 0:
            _run(package, request, nothing, answers)
        _, status = os.waitpid(child, 0)
        answers.write(json.dumps({"exit_code": os.waitstatus_to_exitcode(status)}) + "\n")
        answers.flush()


def _run(package: str, request: dict[str, Any], nothing: int, answers: TextIO) -> None:
    """In the fork: be a process that was started for this one thing. Never returns."""
    code = 1
    try:
        os.close(answers.fileno())
        os.chdir(request["folder"])
        output = os.open(request["output"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        os.dup2(nothing, 0)
        os.dup2(output, 1)
        os.dup2(output, 2)
        resource.setrlimit(resource.RLIMIT_CPU, (request["cpu_s"], request["cpu_s"] + _CPU_GRACE_S))
        if request["memory_bytes"] is not None:
            resource.setrlimit(resource.RLIMIT_AS, (request["memory_bytes"], request["memory_bytes"]))
        sys.argv = [package, *request["arguments"]]
        runpy.run_module(package, run_name="__main__", alter_sys=True)
        code = 0
    except SystemExit as error:
        code = error.code if isinstance(error.code, int) else int(error.code is not None)
        if isinstance(error.code, str):
            print(error.code, file=sys.stderr)
    except BaseException:
        sys.stdout.flush()
        traceback.print_exc()
    finally:
        try:
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            os._exit(code)


if __name__ == "__main__":
    main()
