"""The manifest: which records stand for each episode of each dataset now."""

import json
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any

from demoplan.errors import StoreError, UnknownNameError
from demoplan.ids import content_hash
from demoplan.store.places import AbsentError, NewerError, Place

MANIFEST_FORMAT = 2
"""Format 1 held every state in one file; it is read, and becomes format 2 with the first update."""

LEAST_FOLDED = 128
FOLDED_SHARE = 1 / 16
"""States stay in the manifest itself until there are so many, and so many for each that is listed; then they
are folded into lists: an update of one state among thousands seldom copies all of them."""

_ATTEMPTS = 8


@dataclass(frozen=True, kw_only=True)
class EpisodeState:
    """What the store holds of one episode."""

    dataset: str
    episode_id: str
    tables: dict[str, str] = field(default_factory=dict)
    """Name of a table → hash of its content."""
    keys: dict[str, str] = field(default_factory=dict)
    """Stage → key of the record that gave it."""
    status: str = "complete"
    reason: str | None = None
    attempt: str | None = None
    """Key of the stage run that failed, if one did: it would fail again. It names no record."""


class StateLists:
    """Lists of the states of one dataset's episodes: ``HASH.json``, added and never changed."""

    def __init__(self, place: Place, folder: str) -> None:
        """Use a folder of a place; it is made when something is first written."""
        self._place = place
        self.folder = folder

    def name_of(self, content: str) -> str:
        """What the list of that hash is called in its place."""
        return f"{self.folder}/{content}.json"

    def put(self, states: Iterable[EpisodeState]) -> str:
        """Write a list, and give back its hash: the same for the same states, whoever wrote them and when."""
        ordered = sorted(states, key=lambda state: state.episode_id)
        body = "[\n" + ",\n".join(map(_json, ordered)) + "\n]\n"
        content = content_hash(body)[:32]
        with self._place.draft(".json") as draft:
            draft.write_text(body, encoding="utf-8")
            self._place.settle(draft, self.name_of(content))
        return content

    def get(self, content: str) -> list[EpisodeState]:
        """A list by its hash.

        Raises:
            AbsentError: If it is not there.
            StoreError: If it is not what its name says.
        """
        data = self._place.read(self.name_of(content))
        where = f"{self._place.location}: {self.name_of(content)}"
        if content_hash(data)[:32] != content:
            raise StoreError(f"{where}: its content is not what its name says")
        try:
            return [EpisodeState(**state) for state in json.loads(data)]
        except (ValueError, TypeError) as error:
            raise StoreError(f"{where}: not a list of states: {error}") from None

    def contents(self) -> list[str]:
        """The hashes of all lists that are there."""
        return [
            name.removeprefix(f"{self.folder}/").removesuffix(".json")
            for name in self._place.names(self.folder)
        ]


@dataclass(frozen=True, kw_only=True)
class _Content:
    """What ``manifest.json`` says."""

    lists: dict[str, str] = field(default_factory=dict)
    """Dataset → hash of the list of its states."""
    n_listed: int = 0
    """States in all of these lists."""
    recent: dict[str, dict[str, EpisodeState]] = field(default_factory=dict)
    """Dataset → episode → its state, which goes before that of the list."""

    def rendered(self) -> bytes:
        # One line for each state: a person can read it, and it takes a tenth of the time of indented JSON.
        recent = ",\n".join(
            f"{json.dumps(dataset)}: {{\n"
            + ",\n".join(f"{json.dumps(name)}: {_json(state)}" for name, state in sorted(states.items()))
            + "\n}"
            for dataset, states in sorted(self.recent.items())
        )
        lists = json.dumps(self.lists, sort_keys=True)
        return (
            f'{{"format": {MANIFEST_FORMAT},\n"lists": {lists},\n"n_listed": {self.n_listed},\n'
            f'"recent": {{\n{recent}\n}}}}\n'
        ).encode()


def _json(state: EpisodeState) -> str:
    return json.dumps(vars(state), sort_keys=True)


class Manifest:
    """One file that is replaced as a whole, so that readers see all of an update or nothing.

    It names a list of states for each dataset, and holds what came since itself: an update costs what it
    changes, not what there is. Concurrent writers keep each other's work.
    """

    name = "manifest.json"

    def __init__(self, place: Place) -> None:
        """Use ``manifest.json`` of a place."""
        self._place = place
        self.lists = StateLists(place, "states")

    def update(self, states: Iterable[EpisodeState]) -> None:
        """Put in what is now known of some episodes; the others stay as they are."""
        given: dict[str, dict[str, EpisodeState]] = defaultdict(dict)
        for state in states:
            given[state.dataset][state.episode_id] = state
        if not given:
            return

        superseded: set[str] = set()

        def change(found: bytes | None) -> bytes:
            content = self._parsed(found)
            recent = {dataset: dict(states) for dataset, states in content.recent.items()}
            for dataset, changed in given.items():
                recent[dataset] = recent.get(dataset, {}) | changed
            updated = replace(content, recent=recent)
            most = max(LEAST_FOLDED, FOLDED_SHARE * content.n_listed)
            if sum(map(len, recent.values())) > most:
                updated = self._folded(updated)
                superseded.update(set(content.lists.values()) - set(updated.lists.values()))
            return updated.rendered()

        for attempt in range(_ATTEMPTS):
            try:
                self._place.update(self.name, change)
                break
            except AbsentError:
                # A list that was folded went while another writer's turn was over.
                if attempt == _ATTEMPTS - 1:
                    raise
        self._drop(superseded)

    def _drop(self, contents: set[str]) -> None:
        """Remove lists that are not named any more; where nobody can be held off, sweeping does."""
        if not contents or self._place.least_grace_s > 0:
            return

        def look(found: bytes | None) -> None:
            for content in contents - set(self._parsed(found).lists.values()):
                self._place.remove(self.lists.name_of(content))

        self._place.update(self.name, look)

    def _folded(self, content: _Content) -> _Content:
        lists, n_listed = dict(content.lists), content.n_listed
        for dataset, changed in content.recent.items():
            states = {s.episode_id: s for s in self.lists.get(lists[dataset])} if dataset in lists else {}
            lists[dataset] = self.lists.put((states | changed).values())
            n_listed += len(changed.keys() - states.keys())
        return _Content(lists=lists, n_listed=n_listed)

    def lists_named(self) -> set[str]:
        """The hashes of the lists that the manifest needs."""
        return set(self._content().lists.values())

    def episodes(self, dataset: str | None = None) -> list[EpisodeState]:
        """Every known episode, sorted by dataset and id."""
        for attempt in range(_ATTEMPTS):
            content = self._content()
            known = content.lists.keys() | content.recent.keys()
            if dataset is not None and dataset not in known:
                raise UnknownNameError("dataset", dataset, known, where=f"store {self._place.location}")
            try:
                return [
                    state
                    for name in ([dataset] if dataset is not None else sorted(known))
                    for state in self._states(content, name)
                ]
            except AbsentError:
                # Somebody folded the manifest and swept between the two readings.
                if attempt == _ATTEMPTS - 1:
                    raise
        raise AssertionError("unreachable")

    def _states(self, content: _Content, dataset: str) -> list[EpisodeState]:
        listed = self.lists.get(content.lists[dataset]) if dataset in content.lists else []
        recent = content.recent.get(dataset)
        if not recent:
            return listed
        states = {state.episode_id: state for state in listed} | recent
        return [state for _, state in sorted(states.items())]

    def episode(self, name: str) -> EpisodeState:
        """One episode by its id, or by ``dataset/id`` where the id alone is not unique.

        Raises:
            UnknownNameError: If there is no such episode, or more than one.
        """
        everything = self.episodes()
        found = [s for s in everything if name in (s.episode_id, f"{s.dataset}/{s.episode_id}")]
        if len(found) != 1:
            available = [f"{s.dataset}/{s.episode_id}" for s in (found or everything)]
            raise UnknownNameError("episode", name, available, where=f"store {self._place.location}")
        return found[0]

    def _content(self) -> _Content:
        try:
            return self._parsed(self._place.read(self.name))
        except AbsentError:
            return _Content()

    def _parsed(self, data: bytes | None) -> _Content:
        if data is None:
            return _Content()
        where = f"{self._place.location}: {self.name}"
        try:
            content = json.loads(data)
            written = content["format"]
            if written == 1:
                return _Content(recent=_states_of(content["datasets"]))
            if written == MANIFEST_FORMAT:
                return _Content(
                    lists=dict(content["lists"]),
                    n_listed=int(content["n_listed"]),
                    recent=_states_of(content["recent"]),
                )
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise StoreError(
                f"{where}: not a manifest: {error}; `demoplan store repair` restores the last snapshot"
            ) from None
        raise NewerError(where, "manifest format", written, f"1 to {MANIFEST_FORMAT}")


def _states_of(datasets: dict[str, dict[str, dict[str, Any]]]) -> dict[str, dict[str, EpisodeState]]:
    return {
        dataset: {name: EpisodeState(**state) for name, state in episodes.items()}
        for dataset, episodes in datasets.items()
    }
