"""What of a machine would stand in the way: planner, drawing, versions, database, telemetry, store."""

import importlib.util
import json
import multiprocessing
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from packaging.requirements import InvalidRequirement, Requirement

from demoplan.engines.fast_downward import SolveParams, solve
from demoplan.errors import DemoplanError
from demoplan.language.pddl import parse_domain, parse_problem
from demoplan.store.atomic import PART, locked, write_bytes
from demoplan.store.opening import open_place

DISTRIBUTION = "demoplan"

_DOMAIN = """(define (domain check) (:requirements :typing) (:types thing - object)
 (:predicates (done ?x - thing))
 (:action do :parameters (?x - thing) :precondition (and) :effect (and (done ?x))))"""
_PROBLEM = "(define (problem p) (:domain check) (:objects a - thing) (:init) (:goal (and (done a))))"

TRAPS = (
    ("prefect", "fastapi", "<0.151", "kills Prefect's embedded server as it starts"),
    ("prefect", "sqlalchemy", "<2.1", "keeps Prefect's server from ever making scheduled runs"),
    ("rerun-sdk", "rerun-sdk", ">=0.41,<0.42", "has another interface"),
    ("mujoco", "mujoco", ">=4.0,<4.1", "is packaged otherwise, and gives other results"),
)
"""Where the first is installed: what the second must be, and what another version of it does."""

_FREE_BYTES = 2 * 2**30
"""Less free space than this is told: a run of a hundred episodes takes about as much."""

_STARTUP_S = 60
"""Prefect's embedded server takes 8 s of processor time, 17 s on a new database, more on a busy machine."""

_DRAWING = "import mujoco; c = mujoco.GLContext(64, 64); c.make_current(); c.free()"

_TRUE = ("1", "true", "yes")


@dataclass(frozen=True, order=True)
class Finding:
    """Something about the machine."""

    subject: str
    """``python``, ``versions``, ``planner``, ``drawing``, ``processes``, ``store``, ``database`` …"""
    severity: str
    """``ok``; ``warning``: works, with a drawback; ``error``: something that was installed does not work;
    ``absent``: an optional part is not installed."""
    sentence: str
    remedy: str = ""


@dataclass(frozen=True, kw_only=True)
class Machine:
    """What is looked at; all of it can be given, so that it can be tested."""

    environment: Mapping[str, str]
    store: str
    timeout_s: float = 60.0


def examine(machine: Machine, on_done: Callable[[str], None] = lambda _: None) -> list[Finding]:
    """Look for everything that is known to stand in the way.

    Args:
        machine: What to look at.
        on_done: Called with the name of each part.

    Returns:
        One finding or more for each part, in order.
    """
    findings = []
    for name, check in CHECKS.items():
        findings += list(check(machine))
        on_done(name)
    return findings


def _python(machine: Machine) -> Iterator[Finding]:
    yield Finding("python", "ok", f"{sys.version.split()[0]} at {sys.executable}")
    if sys.dont_write_bytecode or machine.environment.get("PYTHONDONTWRITEBYTECODE"):
        yield Finding(
            "python",
            "warning",
            "bytecode is not written: importing Prefect takes 2.9 s in place of 1.1 s, every time",
            "byte-compile the environment once: python -m compileall -q <site-packages>",
        )


def _versions(machine: Machine) -> Iterator[Finding]:
    """Whether what is installed is what demoplan declares, extras that are there included."""
    wrong = []
    for user, name, needed, effect in TRAPS:
        found = _installed(name)
        if _installed(user) and found and not Requirement(f"{name}{needed}").specifier.contains(found):
            wrong.append(f"{name} {found} {effect}; {needed} is needed")
    try:
        declared = metadata.requires(DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        declared = []
        yield Finding(
            "versions", "warning", "demoplan is not installed, only found on the path: not all is checked"
        )
    for text in declared:
        try:
            requirement = Requirement(text)
        except InvalidRequirement:
            continue
        is_extra = requirement.marker is not None and "extra" in str(requirement.marker)
        found = _installed(requirement.name)
        if found is None:
            if not is_extra:
                wrong.append(f"{requirement.name} is not installed, {requirement.specifier} is needed")
            continue
        if any(requirement.name == name for _, name, _, _ in TRAPS):
            continue
        if not requirement.specifier.contains(found, prereleases=True):
            wrong.append(f"{requirement.name} {found}, {requirement.specifier} is needed")
    for sentence in sorted(set(wrong)):
        yield Finding("versions", "error", sentence, "install with: pip install -c constraints.txt …")
    if not wrong:
        yield Finding("versions", "ok", "every package is one that demoplan declares")


def _installed(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _planner(machine: Machine) -> Iterator[Finding]:
    """A plan of one step, by the planner's own two programs."""
    domain = parse_domain(_DOMAIN)
    try:
        answer = solve(domain, parse_problem(_PROBLEM, domain), SolveParams(wall_s=machine.timeout_s))
    except DemoplanError as error:
        yield Finding("planner", "absent", str(error), "pip install 'demoplan[planner]'")
        return
    if answer.plan is None:
        yield Finding("planner", "error", f"a plan of one step: {answer.outcome}: {answer.message}")
    else:
        yield Finding("planner", "ok", "Fast Downward finds a plan of one step")


def _drawing(machine: Machine) -> Iterator[Finding]:
    if importlib.util.find_spec("mujoco") is None:
        yield Finding("drawing", "absent", "MuJoCo is not installed", "pip install 'demoplan[simulation]'")
    else:
        backends = {b: _draws(machine, b) for b in ("egl", "osmesa")}
        working = [backend for backend, problem in backends.items() if problem is None]
        if working:
            yield Finding("drawing", "ok", f"MuJoCo draws without a screen by {working[0]}")
        else:
            told = "; ".join(f"{name}: {problem}" for name, problem in backends.items())
            yield Finding(
                "drawing",
                "warning",
                f"MuJoCo cannot draw without a screen ({told}); simulating works",
                "apt install libegl1 or libosmesa6",
            )
    drivers = [f for d in ("/usr/share", "/etc") for f in Path(d, "vulkan/icd.d").glob("*.json")]
    if drivers:
        yield Finding("drawing", "ok", f"rerun can draw pictures: {len(drivers)} Vulkan drivers")
    else:
        yield Finding(
            "drawing",
            "warning",
            "no Vulkan driver: rerun draws no pictures (`demoplan view --png`); recordings are written",
            "apt install mesa-vulkan-drivers",
        )


def _draws(machine: Machine, backend: str) -> str | None:
    """Why MuJoCo does not draw by a backend; None if it does. In a process of its own: it may crash."""
    try:
        ended = subprocess.run(
            [sys.executable, "-c", _DRAWING],
            env={**machine.environment, "MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend},
            capture_output=True,
            text=True,
            timeout=machine.timeout_s,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {machine.timeout_s:.0f} s"
    lines = ended.stderr.strip().splitlines()
    return None if ended.returncode == 0 else (lines[-1] if lines else f"exit code {ended.returncode}")


def _processes(machine: Machine) -> Iterator[Finding]:
    n_cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    if "spawn" in multiprocessing.get_all_start_methods():
        yield Finding("processes", "ok", f"{n_cores} cores; processes are spawned, never forked")
    else:
        yield Finding("processes", "error", "processes cannot be spawned here: use --workers 1")


def _store(machine: Machine) -> Iterator[Finding]:
    if "://" in machine.store:
        yield from _bucket(machine.store)
        return
    folder = Path(machine.store).absolute()
    while not folder.exists() and folder != folder.parent:
        folder = folder.parent
    free = shutil.disk_usage(folder).free
    if free < _FREE_BYTES:
        yield Finding("store", "warning", f"{free / 1e9:.1f} GB free at {folder}", "`demoplan store gc`")
    if not os.access(folder, os.W_OK):
        yield Finding("store", "warning", f"{folder} cannot be written: reading commands work")
        return
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=PART) as probe, locked(Path(probe) / "lock"):
            write_bytes(Path(probe) / "file", b"x")
    except (DemoplanError, OSError) as error:
        yield Finding(
            "store",
            "error",
            f"{folder} does not lock and replace files as a store needs: {error}",
            "use a local disk, or NFS 4",
        )
        return
    yield Finding("store", "ok", f"{folder} can be written, locked and replaced in; {free / 1e9:.0f} GB free")


def _bucket(location: str) -> Iterator[Finding]:
    try:
        is_there = open_place(location).exists()
    except DemoplanError as error:
        yield Finding("store", "error", str(error), "credentials and endpoint come from AWS_… variables")
        return
    known = "a store is there" if is_there else "no store is there yet"
    yield Finding("store", "ok", f"{location} answers: {known}")


def _database(machine: Machine) -> Iterator[Finding]:
    """Where Prefect keeps what it knows."""
    if importlib.util.find_spec("prefect") is None:
        yield Finding("database", "absent", "Prefect is not installed", "pip install 'demoplan[flows]'")
        return
    # Here, since it takes seconds, and Prefect is optional.
    from prefect.settings import get_current_settings  # noqa: PLC0415

    settings = get_current_settings()
    if settings.api.url:
        yield Finding("database", "ok", f"flows use the server at {settings.api.url}")
        return
    yield Finding(
        "database",
        "warning",
        f"flows use a server of their own on SQLite below {settings.home}: it locks when several flows write",
        "for a team: `prefect server start` on PostgreSQL, and PREFECT_API_URL",
    )
    if not settings.server.ephemeral.enabled:
        yield Finding(
            "database",
            "error",
            "no server is named, and none may be started: flows will not run",
            "set PREFECT_API_URL, or work in the folder with prefect.toml",
        )
    elif settings.server.ephemeral.startup_timeout_seconds < _STARTUP_S:
        yield Finding(
            "database",
            "warning",
            f"the embedded server has {settings.server.ephemeral.startup_timeout_seconds} s to start; it may "
            "take longer on a new database or a busy machine",
            "PREFECT_SERVER_EPHEMERAL_STARTUP_TIMEOUT_SECONDS=180",
        )


def _telemetry(machine: Machine) -> Iterator[Finding]:
    """Who of those that demoplan builds on would tell its makers that it is used."""
    found = [check(machine) for check in (_prefect_telemetry, _ray_telemetry, _rerun_telemetry)]
    reporting = [finding for finding in found if finding is not None]
    yield from reporting
    if not reporting:
        yield Finding("telemetry", "ok", "demoplan has none, and that of what it builds on is off")


def _prefect_telemetry(machine: Machine) -> Finding | None:
    if importlib.util.find_spec("prefect") is None:
        return None
    # Here, since it takes seconds, and Prefect is optional.
    from prefect.settings import get_current_settings  # noqa: PLC0415

    remedies = []
    if get_current_settings().server.analytics_enabled:
        remedies.append("PREFECT_SERVER_ANALYTICS_ENABLED=false")
    if machine.environment.get("DO_NOT_TRACK", "").lower() not in _TRUE:
        remedies.append("DO_NOT_TRACK=1")
    if not remedies:
        return None
    sentence = "Prefect's commands may report to its makers; demoplan's flows do not"
    return Finding("telemetry", "warning", sentence, " and ".join(remedies))


def _ray_telemetry(machine: Machine) -> Finding | None:
    if importlib.util.find_spec("ray") is None or machine.environment.get("RAY_USAGE_STATS_ENABLED") == "0":
        return None
    sentence = "Ray's commands may report to its makers; demoplan's flows do not"
    return Finding("telemetry", "warning", sentence, "RAY_USAGE_STATS_ENABLED=0")


def _rerun_telemetry(machine: Machine) -> Finding | None:
    """The viewer knows no environment variable for it, only a file, which it writes when it first starts."""
    home = machine.environment.get("HOME", "~")
    folder = machine.environment.get("XDG_CONFIG_HOME") or f"{home}/.config"
    try:
        chosen = json.loads(Path(folder, "rerun", "analytics.json").expanduser().read_text(encoding="utf-8"))
        if chosen.get("analytics_enabled") is False:
            return None
    except (OSError, ValueError, AttributeError):
        pass  # not chosen yet: then it is on
    return Finding(
        "telemetry", "warning", "rerun's viewer reports its use to its makers", "rerun analytics disable"
    )


CHECKS: Mapping[str, Callable[[Machine], Iterator[Finding]]] = {
    "python": _python,
    "versions": _versions,
    "planner": _planner,
    "drawing": _drawing,
    "processes": _processes,
    "store": _store,
    "database": _database,
    "telemetry": _telemetry,
}
"""Parts that are looked at, in order."""
