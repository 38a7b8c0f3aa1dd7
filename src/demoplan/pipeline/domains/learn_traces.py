"""Learn a domain from a folder of symbolic traces: read, learn, write."""

import re
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from demoplan.errors import ManifestError, PddlError, UsageError
from demoplan.language.traces import (
    Fault,
    Signatures,
    TraceReader,
    infer_signatures,
    read_objects,
    read_signatures,
    render_strips,
)
from demoplan.stages.denoise import Denoised, DenoiseParams, Gathered, conclude, gather

_MAX_PENDING = 2_000_000
"""Observed atoms that are read before they are counted and, for the most part, let go."""

_NUMBER = re.compile(r"\d+")


@dataclass(frozen=True)
class LearnTracesReport:
    """What was learned from, what came of it, and what was left out."""

    denoised: Denoised
    signatures: Signatures
    faults: tuple[Fault, ...]
    n_traces: int
    n_transitions: int
    unseen_actions: tuple[str, ...]
    """Actions of the signatures without an instance: the domain leaves them out."""
    read_s: float
    learn_s: float

    @property
    def exit_code(self) -> int:
        """0 if everything was used, 3 if something was left out."""
        return 3 if self.faults else 0


def learn_traces(case_dir: Path, out: Path, params: DenoiseParams = DenoiseParams()) -> LearnTracesReport:
    """Learn from a case and write the domain.

    Args:
        case_dir: Folder with ``trajectories/N_traj`` and, where there are any, ``domain.pddl`` (types,
            constants, predicates, actions with parameters) and ``problems/N_prob.pddl`` (objects of
            trajectory N). Or one trajectory file, with ``domain.pddl`` beside it or not. Without a domain the
            signatures are inferred from the traces.
        out: Where the domain is written.
        params: Priors and limits.

    Returns:
        What was learned, and everything that was left out, by file and line.

    Raises:
        UsageError: If there is no trajectory, or no file has anything to learn from.
    """
    start = time.perf_counter()
    files = _trajectories(case_dir)
    root = case_dir if case_dir.is_dir() else case_dir.parent
    gathered, signatures, faults = _read(root, files, params)
    n_transitions = int(gathered.counts.n_transitions.sum())
    if n_transitions == 0:
        told = "; ".join(str(fault) for fault in faults[:3])
        raise UsageError(
            f"{case_dir}: no transition to learn from in {len(files)} files: {told or 'all are empty'}"
        )
    read_s = time.perf_counter() - start
    denoised = conclude(gathered, params)
    actions = denoised.actions()
    _write(out, render_strips(signatures, actions))
    known = set(actions)
    return LearnTracesReport(
        denoised=denoised,
        signatures=signatures,
        faults=faults,
        n_traces=len(files),
        n_transitions=n_transitions,
        unseen_actions=tuple(each.name for each in signatures.actions if each.name not in known),
        read_s=read_s,
        learn_s=time.perf_counter() - start - read_s,
    )


def _trajectories(case: Path) -> list[Path]:
    if case.is_file():
        return [case]
    folder = case / "trajectories"
    if not folder.is_dir():
        raise UsageError(f"{case}: neither a trajectory file nor a folder with trajectories/ in it")
    files = [path for path in folder.iterdir() if path.is_file() and not path.name.startswith(".")]
    if not files:
        raise UsageError(f"{folder}: no trajectory in it; expected files N_traj")
    return sorted(files, key=lambda path: (_number(path), path.name))


def _number(path: Path) -> int:
    match = _NUMBER.match(path.name)
    return int(match[0]) if match else -1


def _read(
    root: Path, files: list[Path], params: DenoiseParams
) -> tuple[Gathered, Signatures, tuple[Fault, ...]]:
    """Read file by file, and keep what learning needs, so that memory does not grow with the files."""
    faults: list[Fault] = []
    domain = root / "domain.pddl"
    if domain.is_file():
        signatures, found = read_signatures(_text(domain), domain.name)
    else:
        signatures, found = infer_signatures(_texts(root, files, faults))
        faults.clear()  # told again when the files are read
    faults += found
    problems = _problems(root)
    reader = TraceReader(signatures)
    gathered: Gathered | None = None
    for text, path in _texts(root, files, faults):
        objects: dict[str, str] | None = None
        if domain.is_file():  # inferred types are not those of the problems
            objects, found = _objects(root, problems.get(_number(Path(path))), signatures)
            faults += found
        reader.add(text, path, objects)
        if reader.n_pending > _MAX_PENDING:
            gathered = gather(reader.take(), params, gathered)
    gathered = gather(reader.take(), params, gathered)
    return gathered, signatures, tuple(sorted((*faults, *reader.faults)))


def _texts(root: Path, files: list[Path], faults: list[Fault]) -> Iterator[tuple[str, str]]:
    """Text and name of each file; what is not text becomes a fault."""
    for path in files:
        name = path.relative_to(root).as_posix()
        try:
            yield path.read_text(encoding="utf-8"), name
        except (OSError, UnicodeDecodeError) as error:
            faults.append(Fault(name, 1, f"not readable as text: {error}"))


def _problems(root: Path) -> dict[int, Path]:
    """Problem files by number; of several with one number the first by name."""
    found = sorted((root / "problems").glob("[0-9]*_*.pddl"), reverse=True)
    return {_number(path): path for path in found}


def _objects(
    root: Path, path: Path | None, signatures: Signatures
) -> tuple[dict[str, str] | None, tuple[Fault, ...]]:
    """Objects of a problem, if there is one and it is a problem."""
    if path is None:
        return None, ()
    name = path.relative_to(root).as_posix()
    try:
        return read_objects(_text(path), name, signatures)
    except (PddlError, ManifestError) as error:
        return None, (Fault(name, 1, f"objects taken as they are found: {error}"),)


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ManifestError(path, None, f"not readable as text: {error}") from error


def _write(out: Path, text: str) -> None:
    """Write beside the target and rename, so that no half-written domain is ever seen."""
    partial = out.with_name(f".{out.name}.partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(out)
