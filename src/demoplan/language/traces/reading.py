"""Trace files to codes: what is regular in one go, what is not item by item, with a word on what is wrong."""

import bisect
import re
from collections.abc import Mapping

import numpy as np

from demoplan.language.traces.columns import Columns
from demoplan.language.traces.judging import Action, AtomCodes, Declared, Judge
from demoplan.language.traces.scanning import LEAF, NEGATION, Item, head_of, items, without_comments
from demoplan.language.traces.tokens import Pieces
from demoplan.language.traces.values import ABSENT, Codes, Fault, Signatures, TraceSet

_LINE_END = re.compile("\n")
_NOT_LOOKED_UP = np.iinfo(np.int64).min


class TraceReader:
    """Reads traces one after another into one set of tables; what it cannot use becomes faults.

    Where a trace breaks (an unknown action, a state without an action before it), it continues as another
    trace of the same name: nothing is learned across the break.
    """

    def __init__(self, signatures: Signatures) -> None:
        """Start without traces.

        Args:
            signatures: What predicates and actions there are; atoms and actions that do not fit are faults.
        """
        self.signatures = signatures
        self._codes = AtomCodes(signatures)
        self._judge = Judge(signatures, self._codes)
        self._pieces = Pieces()
        self._leaf_codes = np.zeros(0, dtype=np.int64)
        self._columns = Columns()
        self._declared: dict[tuple[tuple[str, str], ...], Declared] = {}
        self._faults: dict[tuple[str, str], tuple[int, int]] = {}

    @property
    def faults(self) -> tuple[Fault, ...]:
        """What was left out so far, by file and line."""
        return tuple(
            sorted(Fault(file, line, problem, n) for (file, problem), (line, n) in self._faults.items())
        )

    def add(self, text: str, file: str, objects: Mapping[str, str] | None = None) -> None:
        """Read one trace.

        Args:
            text: The trace.
            file: Its name, for messages and as the trace's name.
            objects: Types of its objects by name. Without them every object is taken as fitting.
        """
        source = _Source(
            without_comments(text), file, None if objects is None else self._declare(objects), self
        )
        if not self._quick(source):
            self._sequence(source)

    def _declare(self, objects: Mapping[str, str]) -> Declared:
        kinds = {name.lower(): kind for name, kind in (*self.signatures.constants, *objects.items())}
        key = tuple(sorted(kinds.items()))
        if key not in self._declared:
            codes = self._codes.objects
            types = {codes.setdefault(name, len(codes)): kind for name, kind in kinds.items()}
            self._declared[key] = Declared(types)
        return self._declared[key]

    def _quick(self, source: "_Source") -> bool:
        """Read a trace that has nothing wrong with it; otherwise change nothing and say so."""
        regular = self._pieces.regular(source.text)
        if regular is None:
            return False
        codes = self._atoms(regular.atoms)
        if len(codes) and codes.min() < 0:
            return False
        declared = source.declared
        if declared is not None:
            self._judge.judge(codes, declared)
            if declared.misfits and not declared.misfits.keys().isdisjoint(codes.tolist()):
                return False
        known = {} if declared is None else declared.actions
        actions: list[Action] = []
        for leaf in regular.actions.tolist():
            text = self._pieces.leaves[leaf]
            action = known.get(text)
            if action is None:
                action, problem = self._judge.action(f"({text})", declared)
                if problem or action is None:
                    return False
                known[text] = action
            actions.append(action)
        trace = self._columns.begin(source.file, declared)
        self._columns.add_trace(trace, regular.sizes, codes, actions)
        return True

    def _atoms(self, leaves: Codes) -> Codes:
        """Codes of the atoms that leaves are, looked up once each."""
        n = len(self._pieces.leaves)
        if len(self._leaf_codes) < n:
            added = np.full(n - len(self._leaf_codes), _NOT_LOOKED_UP, dtype=np.int64)
            self._leaf_codes = np.concatenate([self._leaf_codes, added])
        is_met = np.zeros(n, dtype=np.bool_)
        is_met[leaves] = True
        for leaf in np.flatnonzero(is_met & (self._leaf_codes == _NOT_LOOKED_UP)).tolist():
            self._leaf_codes[leaf] = self._codes[self._pieces.leaves[leaf]]
        return np.asarray(self._leaf_codes[leaves])

    def _sequence(self, source: "_Source") -> None:
        """States and actions in turn; a break starts a new trace."""
        columns = self._columns
        n_states, n_actions = 0, 0
        trace = ABSENT
        last = "nothing"
        source.is_partial, problem = head_of(source.text)
        if problem:
            source.fault(len(source.text) - len(source.text.lstrip()), problem)
        for item in items(source.text):
            if item.is_action:
                action = self._action(item, source)
                if last == "nothing":
                    source.fault(item.start, "action without a state before it")
                    continue
                if last == "action":
                    source.fault(item.start, "action without a state between it and the one before")
                    columns.add_state(trace, [], [], is_partial=True)
                if action is None:
                    trace, last = ABSENT, "nothing"
                    continue
                columns.add_action(action)
                n_actions, last = n_actions + 1, "action"
                continue
            n_states += 1
            if last == "state":
                source.fault(item.start, "state without an action between it and the one before")
                trace = ABSENT
            if trace == ABSENT:
                trace = columns.begin(source.file, source.declared)
            true, false, is_partial = self._state(item, source)
            columns.add_state(trace, true, false, is_partial=is_partial or source.is_partial)
            last = "state"
        if last == "action":
            source.fault(len(source.text), "action without a state after it")
            columns.drop_action()
            n_actions -= 1
        if n_states == 0 and not source.n_faults:
            source.fault(0, "empty trace: no state in it")
        elif n_actions <= 0 and not source.n_faults:
            source.fault(0, "empty trace: no action between states in it")

    def _state(self, item: Item, source: "_Source") -> tuple[list[int], list[int], bool]:
        if item.problem:
            source.fault(item.start, item.problem)
            return [], [], True
        body, denied = item.body, list[str]()
        if "not" in body.lower() and NEGATION.search(body):
            denied = NEGATION.findall(body)
            body = NEGATION.sub("", body)
        true = list(map(self._codes.__getitem__, LEAF.findall(body)))
        false = list(map(self._codes.__getitem__, denied))
        if min(true, default=0) < 0 or min(false, default=0) < 0:
            for text in (*LEAF.findall(body), *denied):
                code = self._codes[text]
                if code < 0:
                    source.fault(
                        item.start + max(item.body.find(f"({text})"), 0), self._codes.problems[-code - 1]
                    )
            true = [code for code in true if code >= 0]
            false = [code for code in false if code >= 0]
        if source.declared is not None:
            true = self._fitting(true, item, source, source.declared)
            false = self._fitting(false, item, source, source.declared)
        return true, false, bool(denied)

    def _fitting(self, codes: list[int], item: Item, source: "_Source", declared: Declared) -> list[int]:
        """Codes of atoms whose objects are declared and of the right types."""
        self._judge.judge(np.array(codes, dtype=np.int64), declared)
        misfits = declared.misfits
        if not misfits or misfits.keys().isdisjoint(codes):
            return codes
        for code in sorted(misfits.keys() & set(codes)):
            source.fault(item.start, misfits[code])
        return [code for code in codes if code not in misfits]

    def _action(self, item: Item, source: "_Source") -> Action | None:
        """The action's signature and objects, or nothing after telling the fault."""
        found, problem = self._judge.action(item.body, source.declared)
        if item.problem or problem:
            source.fault(item.start, item.problem or problem)
            return None
        return found

    def note(self, file: str, line: int, problem: str) -> None:
        """Keep a fault; the same one again in the same file only counts."""
        first, n = self._faults.get((file, problem), (line, 0))
        self._faults[file, problem] = (first, n + 1)

    @property
    def n_pending(self) -> int:
        """Atoms read since the last :meth:`take`, with repetitions: what memory is held for."""
        return sum(map(len, self._columns.true_atoms))

    def take(self) -> TraceSet:
        """Everything read since the last call, as tables, and forget it.

        Atoms and objects keep their codes: sets that one reader gave can be joined.
        """
        columns, self._columns = self._columns, Columns()
        return columns.tables(self.signatures, self._codes)


class _Source:
    """One file's text and what it declares; counts its lines when something is wrong."""

    def __init__(self, text: str, file: str, declared: Declared | None, reader: TraceReader) -> None:
        self.text, self.file, self.declared, self._reader = text, file, declared, reader
        self.n_faults = 0
        self.is_partial = False
        self._line_ends: list[int] = []

    def fault(self, position: int, problem: str) -> None:
        self.n_faults += 1
        if not self._line_ends:
            self._line_ends = [match.start() for match in _LINE_END.finditer(self.text)] or [len(self.text)]
        self._reader.note(self.file, bisect.bisect_left(self._line_ends, position) + 1, problem)
