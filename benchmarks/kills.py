"""How often a store loses something when processes are killed at random while they work on it.

Two processes at a time work on one store: they ingest, segment, learn and publish a domain, compact and
sweep, over and over, each time with other parameters so that there is something to do. Both are killed
(SIGKILL): half of them after a random time, half at a random point of their own: the n-th time that they
open, rename, link or remove a file of the store. After each kill the store is held against itself and
against what the killed processes had said was done. In the end, undisturbed, one more pass must give what it
gives in a store of its own.

    python benchmarks/kills.py --kills 200
"""

import argparse
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

from demoplan.pipeline.datasets import open_dataset
from demoplan.pipeline.domains.learning import learn_domain
from demoplan.pipeline.episodes.activities import segment_episodes
from demoplan.pipeline.episodes.ingest import ingest, jobs_of
from demoplan.pipeline.episodes.segmenters import rules, usable
from demoplan.store import Store
from demoplan.store.compacting import compact
from demoplan.store.sweeping import sweep
from demoplan.store.verifying import verify

DATASET = Path(__file__).resolve().parents[1] / "datasets/cube-stacking"
EPISODES = ("p1-one-left", "p2-one-right")
LONGEST_S, MOST_EVENTS = 4.0, 1200
"""Until when a process is killed, and at which event at the latest."""

EVENTS = ("open", "os.rename", "os.link", "os.remove")
"""Names of audit events at which a process kills itself."""


def say(**what):
    """Tell the parent what is done; it holds the store to it."""
    print(json.dumps(what), flush=True)


def opened(name, tick_rate_hz):
    """A small dataset, read with some parameter of its own."""
    whole = open_dataset(DATASET)
    episodes = [episode for episode in whole.dataset.episodes if episode.id in EPISODES]
    changed = {"name": name, "episodes": episodes, "splits": {}, "tick_rate_hz": tick_rate_hz}
    return replace(whole, dataset=whole.dataset.model_copy(update=changed))


def one_pass(store, name, tick_rate_hz, say=lambda **_: None):
    """Logs to a published domain; says which stage runs and versions are done."""
    data = opened(name, tick_rate_hz)
    jobs = jobs_of(data, store, data.dataset.episodes)
    states = ingest(jobs, n_workers=1, on_done=lambda _: None)
    say(keys=[list(item) for state in states for item in state.keys.items()])
    states = segment_episodes(data, store, states, {s.episode_id: rules() for s in usable(states)})
    say(keys=[list(item) for state in states for item in state.keys.items()])
    learned = learn_domain(store, states, data.vocabulary, name=name, dataset=name)
    say(domain=[name, learned.version.domain_id])
    say(snapshot=store.snapshots.take(store.manifest.episodes(), f"{name} {tick_rate_hz}"))
    return states, learned


def victim(location, name, seed, kill_at):
    """Work until killed."""
    dice = random.Random(seed)
    n_events = 0

    def count(event, arguments):
        nonlocal n_events
        if event in EVENTS and location in str(arguments[0]):
            n_events += 1
            if n_events == kill_at:
                os.kill(os.getpid(), signal.SIGKILL)

    store = Store(location)
    say(ready=True)
    if kill_at:
        sys.addaudithook(count)
    while True:
        for act in dice.choice(("w", "wc", "wcg", "cg", "wg")):
            if act == "w":
                one_pass(store, name, 20.0 + dice.randrange(200) / 8, say)
            elif act == "c":
                compact(store)
            else:
                sweep(store, grace_s=0.0)


def losses(location, promised):
    """What of the promised is not there, and what is not as it was written."""
    store = Store(location)
    found = [
        f"{fault.kind}: {fault.path}: {fault.detail}" for fault in verify(store) if not fault.is_harmless
    ]
    index = store.index()
    found += [
        f"lost: record {stage} {key}" for stage, key in promised["keys"] if index.find(stage, key) is None
    ]
    for name, domain_id in promised["domains"]:
        if domain_id not in {each.domain_id for each in store.domains.versions() if each.name == name}:
            found.append(f"lost: domain {name} {domain_id}")
    known = set(store.snapshots.ids())
    found += [f"lost: snapshot {each}" for each in promised["snapshots"] if each not in known]
    return found


def start(location, name, dice, is_timed):
    """A process that works, and when it dies: at the n-th event, or so many seconds after it is ready."""
    kill_at = 0 if is_timed else dice.randrange(1, MOST_EVENTS)
    arguments = ["--victim", location, name, str(dice.randrange(10**9)), str(kill_at)]
    return subprocess.Popen(
        [sys.executable, __file__, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "POLARS_MAX_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )


def outcome(process, promised):
    """Note what a killed process had promised; give back what went wrong before it was killed."""
    said, trouble = process.communicate()
    for line in said.splitlines():
        try:
            told = json.loads(line)
        except ValueError:  # killed while it spoke
            continue
        promised["keys"] |= {tuple(item) for item in told.get("keys", ())}
        promised["domains"] |= {tuple(told["domain"])} if "domain" in told else set()
        promised["snapshots"] |= {told["snapshot"]} if "snapshot" in told else set()
    if process.returncode != -signal.SIGKILL:
        return [f"ended with {process.returncode}: {trouble.strip()[-400:]}"]
    return []


def undisturbed(location, folder):
    """What a last pass gives that differs from the same in a store of its own."""
    here, here_domain = one_pass(Store(location), "a", 25.0)
    there, there_domain = one_pass(Store(folder), "a", 25.0)
    different = [state.episode_id for state, other in zip(here, there, strict=True) if state != other]
    if here_domain.version.domain_id != there_domain.version.domain_id:
        different.append("domain")
    return [f"different from an undisturbed store: {each}" for each in different]


def run(n_kills, seed):
    dice = random.Random(seed)
    folder = Path(tempfile.mkdtemp(prefix="demoplan-kills-"))
    location = str(folder / "store")
    promised = {"keys": set(), "domains": set(), "snapshots": set()}
    troubles, killed = [], Counter()
    began = time.monotonic()
    while killed.total() < n_kills:
        timed = [dice.random() < 0.5 for _ in range(2)]
        both = [start(location, name, dice, is_timed) for name, is_timed in zip("ab", timed, strict=True)]
        for process in both:
            process.stdout.readline()
        deadline = time.monotonic() + 60
        for process, is_timed in zip(both, timed, strict=True):
            if is_timed:
                time.sleep(dice.uniform(0.0, LONGEST_S))
                process.kill()
        for process, is_timed in zip(both, timed, strict=True):
            while process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.01)
            process.kill()
            troubles += outcome(process, promised)
            killed["after a time" if is_timed else "at a file operation"] += 1
        troubles += losses(location, promised)
        print(f"\r{killed.total()} kills, {len(troubles)} troubles ", end="", file=sys.stderr, flush=True)
    troubles += undisturbed(location, str(folder / "other"))
    troubles += losses(location, promised)
    result = {
        "kills": killed.total(),
        **killed,
        "stage runs promised": len(promised["keys"]),
        "domain versions promised": len(promised["domains"]),
        "snapshots promised": len(promised["snapshots"]),
        "lost or corrupt": len(troubles),
        "troubles": troubles[:20],
        "seconds": round(time.monotonic() - began, 1),
    }
    if not troubles:
        shutil.rmtree(folder)
    return result


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--victim", nargs=4, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.victim:
        location, name, seed, kill_at = asked.victim
        victim(location, name, int(seed), int(kill_at))
    result = run(asked.kills, asked.seed)
    print(file=sys.stderr)
    if asked.json:
        print(json.dumps(result))
    else:
        for name, value in result.items():
            print(f"{name:28} {value}")
    sys.exit(bool(result["lost or corrupt"]))


if __name__ == "__main__":
    main()
