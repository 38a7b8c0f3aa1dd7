"""A program of its own: keeps a Python package loaded, and runs it anew, in a fork, for every request.

Started as ``python preloading.py PACKAGE [ARGUMENT …]``, it does what ``python -m PACKAGE`` does, less the
time that starting and importing take. Requests and answers are lines of JSON on its own input and output; it
ends when its input ends. A fork is safe here, and only here: this process has one thread and imports nothing
else.

A fresh interpreter is slow at first: it adapts its code to the types that it meets, and a fork that ends
takes what it learned along. So if arguments are given, the package is run with them once in this process
itself, as practice, from which all later forks gain. It comes after the answer to the first request that went
well, where nobody waits for it, and what it changed in modules is put back.

A request: ``arguments``, ``folder`` (working directory), ``output`` (file that takes what is printed),
``cpu_s`` (limit on processor time, whole seconds) and ``memory_bytes`` (limit on address space, or null). An
answer: ``exit_code``, negative for a signal.
"""

import copy
import gc
import importlib
import json
import os
import resource
import runpy
import sys
import traceback
from collections.abc import Sequence
from types import ModuleType
from typing import Any

_CPU_GRACE_S = 2
"""After the soft limit the package may end in order; so much later the kernel ends it [s]."""
_COLLECTION_THRESHOLDS = (50_000, 20, 50)
"""Of the garbage collector, in a fork. With Python's own (700, 10, 10) it takes a twentieth of a small task,
to find next to nothing: there is little in circles."""


def main() -> None:
    """Load, then answer requests to the end of the input."""
    package, *practice = sys.argv[1:]
    # What is loaded stays, and so does what little garbage it makes: looking for that takes a while.
    gc.disable()
    # What modules print while they are loaded, or a fork at any time, must not look like an answer; what they
    # read must not be a request.
    requests, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    nothing = os.open(os.devnull, os.O_RDWR)
    os.dup2(nothing, 0)
    os.dup2(nothing, 1)
    # This imports all that it will need; run it is anew each time, and as the main module.
    importlib.import_module(f"{package}.__main__")
    del sys.modules[f"{package}.__main__"]
    # Collecting garbage in a fork would copy every page that it looks at.
    gc.freeze()
    for line in requests:
        request = json.loads(line)
        child = os.fork()
        if child == 0:
            os.close(requests.fileno())
            os.close(answers.fileno())
            _run(package, request)
        _, status = os.waitpid(child, 0)
        answers.write(json.dumps({"exit_code": os.waitstatus_to_exitcode(status)}) + "\n")
        answers.flush()
        if practice and status == 0:
            _practise(package, practice)
            practice = []


def _practise(package: str, arguments: Sequence[str]) -> None:
    """Run the package here; however it ends, its modules are as they were."""
    modules = [
        module
        for name, module in sys.modules.items()
        if name != "__main__" and name.partition(".")[0] not in sys.stdlib_module_names
    ]
    states = [(module, _state(module)) for module in modules]
    sys.argv = [package, *arguments]
    try:
        runpy.run_module(package, run_name="__main__", alter_sys=True)
    except BaseException:
        # Practice that fails teaches less, and harms nobody: requests are answered as before.
        traceback.print_exc()
    # What is still to be written would be written again by every fork.
    sys.stdout.flush()
    for module, state in states:
        _restore(module, state)
    gc.freeze()


def _state(module: ModuleType) -> dict[str, tuple[Any, Any]]:
    """What a module's names stand for, and what lists, sets and dictionaries among that hold."""
    return {
        name: (value, copy.copy(value) if type(value) in (list, set, dict) else None)
        for name, value in vars(module).items()
    }


def _restore(module: ModuleType, state: dict[str, tuple[Any, Any]]) -> None:
    names = vars(module)
    for added in names.keys() - state.keys():
        del names[added]
    for name, (value, content) in state.items():
        if name not in names or names[name] is not value:
            names[name] = value
        if content is not None and value != content:
            value.clear()
            add = value.extend if isinstance(value, list) else value.update
            add(content)


def _run(package: str, request: dict[str, Any]) -> None:
    """In the fork: be a process that was started for this one thing. Never returns."""
    gc.set_threshold(*_COLLECTION_THRESHOLDS)
    gc.enable()
    code = 1
    try:
        os.chdir(request["folder"])
        output = os.open(request["output"], os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
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
