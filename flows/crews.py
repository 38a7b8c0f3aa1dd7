"""Who works on episodes: processes here, or the workers of a Dask or Ray cluster. One setting says which."""

import asyncio
import os
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from dataclasses import dataclass
from ipaddress import ip_address
from typing import Any, Literal, TypeVar, get_args
from urllib.parse import urlsplit

from prefect import task
from prefect.cache_policies import NO_CACHE
from prefect.context import FlowRunContext
from prefect.settings import PREFECT_API_URL, temporary_settings
from prefect.task_runners import TaskRunner, ThreadPoolTaskRunner

from demoplan.errors import DemoplanError, UsageError
from demoplan.pipeline.crews import Crew, Processes
from demoplan.pipeline.reporting import Progress
from flows.progress import ArtifactProgress

Order = TypeVar("Order")
Result = TypeVar("Result")
RunnerName = Literal["processes", "threads", "dask", "ray"]

RUNNER_VARIABLE, ADDRESS_VARIABLE = "DEMOPLAN_RUNNER", "DEMOPLAN_RUNNER_ADDRESS"
"""What says who works where a flow's parameters do not."""

MOST_ORDERS = 4
"""Orders in one task. A task costs some 0.1 s of processor time besides its work, an order of sixteen short
episodes is 1 to 2 s of work. Measured by ``benchmarks/orchestration.py``."""

TASKS_AHEAD = 8
"""Tasks given for each worker before the first of them has ended."""

DESERTED_S = 600.0
"""How long a cluster may be without any worker: one that scales itself brings some within minutes."""
PULSE_S = 5.0
"""How often a cluster that one waits for is asked whether it has workers."""

MOST_DEATHS = 1
"""How often a task goes to another worker when the one that had it died; then its orders go one by one."""


@dataclass(frozen=True, kw_only=True)
class Workplace:
    """Who works, and where they are found."""

    runner: RunnerName
    address: str | None = None
    """Of a cluster that is there already; without it, one is started on this machine and ended after."""
    n_workers: int = 2
    """Processes or threads here; of a cluster elsewhere, about how many work at once."""


def workplace(
    runner: str | None, address: str | None, n_workers: int, environment: Mapping[str, str] = os.environ
) -> Workplace:
    """Who works: as asked for, else as the environment says, else processes of this machine.

    Raises:
        UsageError: If there is no such runner, or an address is given to one that has none.
    """
    name = runner or environment.get(RUNNER_VARIABLE) or "processes"
    where = address or (None if runner else environment.get(ADDRESS_VARIABLE)) or None
    if name not in get_args(RunnerName):
        raise UsageError(f"unknown runner {name!r}; known: {', '.join(get_args(RunnerName))}")
    if where and name in ("processes", "threads"):
        raise UsageError(f"{name} are on this machine; an address ({where}) is for dask and ray")
    return Workplace(runner=name, address=where, n_workers=n_workers)  # type: ignore[arg-type]


@contextmanager
def crew_of(place: Workplace) -> Iterator[Crew]:
    """A crew for the time of the block; it is to be used in the thread that enters it.

    Raises:
        UsageError: If the extra is not installed, or the workers could not reach Prefect's server.
    """
    if place.runner == "processes":
        yield Processes(place.n_workers)
        return
    with ExitStack() as stack:
        stack.enter_context(temporary_settings({PREFECT_API_URL: _server_of(place)}))
        runner, deaths, options, wait = _RUNNERS[place.runner](place)
        stack.enter_context(options)
        yield TaskCrew(stack.enter_context(runner), deaths, place.n_workers, wait)


async def in_crew(place: Workplace, work: Callable[[Crew, Progress], Result]) -> Result:
    """What some work gives that has a crew, in a thread of its own; how far it is becomes an artifact."""
    progress = ArtifactProgress()

    def whole() -> Result:
        with crew_of(place) as crew:
            return work(crew, progress)

    return await asyncio.to_thread(whole)


@task(name="work", tags=["cpu"], cache_policy=NO_CACHE, persist_result=False, log_prints=False)
def run_orders(work: Callable[[Order], Result], orders: Sequence[Order]) -> list[Result]:
    """Do the work for some orders, on a worker; an order that was done before is found done."""
    return [work(order) for order in orders]


@dataclass(frozen=True)
class TaskCrew:
    """A crew whose workers run Prefect tasks, some orders in each."""

    runner: TaskRunner[Any]
    deaths: tuple[type[BaseException], ...]
    """What is raised when workers died over a task as often as it may be tried."""
    n_workers: int
    wait: "_Wait" = lambda _: None
    """Waits for a task; raises if nobody is there any more to do it."""
    most_orders: int = MOST_ORDERS

    def __call__(
        self, work: Callable[[Order], Result], orders: Sequence[Order]
    ) -> Iterator[tuple[Order, Result | None]]:
        """See ``Crew``. When workers died over a task, its orders are tried one by one."""
        size = max(1, min(self.most_orders, len(orders) // (2 * self.n_workers)))
        batches = deque(orders[i : i + size] for i in range(0, len(orders), size))
        given: deque[tuple[Sequence[Order], Any]] = deque()
        while batches or given:
            while batches and len(given) < TASKS_AHEAD * self.n_workers:
                batch = batches.popleft()
                given.append((batch, self._give(work, batch)))
            batch, future = given.popleft()
            try:
                yield from zip(batch, self._result(future), strict=True)
            except self.deaths:
                yield from self._one_by_one(work, batch)

    def _one_by_one(
        self, work: Callable[[Order], Result], orders: Sequence[Order]
    ) -> Iterator[tuple[Order, Result | None]]:
        for order in orders:
            try:
                (result,) = self._result(self._give(work, [order]))
            except self.deaths:
                yield order, None
            else:
                yield order, result

    def _give(self, work: Callable[[Order], Result], orders: Sequence[Order]) -> Any:
        return self.runner.submit(run_orders, {"work": work, "orders": list(orders)})

    def _result(self, future: Any) -> Any:
        self.wait(future)
        return future.result()


_LOADED = "__prefect_loader_"
"""How Prefect names a flow's module that it has loaded from a file; no worker can import it by that name."""

_Wait = Callable[[Any], None]
_Started = tuple[TaskRunner[Any], tuple[type[BaseException], ...], AbstractContextManager[Any], _Wait]


def _threads(place: Workplace) -> _Started:
    return ThreadPoolTaskRunner(max_workers=place.n_workers), (), ExitStack(), lambda _: None


def _dask(place: Workplace) -> _Started:
    try:
        import dask  # noqa: PLC0415
        import distributed  # noqa: PLC0415
        from distributed.scheduler import KilledWorker  # noqa: PLC0415
        from prefect_dask import DaskTaskRunner  # noqa: PLC0415
    except ImportError:
        raise UsageError("runner 'dask' needs the extra: pip install 'demoplan[dask]'") from None
    local = {
        "n_workers": place.n_workers,
        "threads_per_worker": 1,
        "processes": True,
        "host": "127.0.0.1",
        "dashboard_address": None,
    }
    runner = DaskTaskRunner(address=place.address) if place.address else DaskTaskRunner(cluster_kwargs=local)
    limits = dask.config.set({"distributed.scheduler.allowed-failures": MOST_DEATHS})

    def wait(future: Any) -> None:
        manned_s = time.monotonic()
        where = f"the Dask cluster at {runner.client.scheduler.address}"
        while not future.wrapped_future.done():
            try:
                with runner.client.as_current(), suppress(distributed.TimeoutError):
                    distributed.wait(future.wrapped_future, timeout=PULSE_S)
            except distributed.CancelledError as error:
                raise DemoplanError(f"{where} went away: {error}") from None
            if runner.client.scheduler_info(n_workers=1)["workers"]:
                manned_s = time.monotonic()
            elif time.monotonic() - manned_s > DESERTED_S:
                raise DemoplanError(f"{where} has had no worker for {DESERTED_S:.0f} s")

    return runner, (KilledWorker,), limits, wait


def _ray(place: Workplace) -> _Started:
    try:
        from prefect_ray import RayTaskRunner  # noqa: PLC0415
        from prefect_ray.context import remote_options  # noqa: PLC0415
        from ray import cloudpickle, exceptions  # noqa: PLC0415
    except ImportError:
        raise UsageError("runner 'ray' needs the extra: pip install 'demoplan[ray]'") from None
    for name in [name for name in sys.modules if name.startswith(_LOADED)]:
        cloudpickle.register_pickle_by_value(sys.modules[name])
    local = {
        "num_cpus": place.n_workers,
        "include_dashboard": False,
        "_node_ip_address": "127.0.0.1",
        # Its workers find what this process finds; those of Dask are told by themselves.
        "runtime_env": {"env_vars": {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}},
    }
    runner = RayTaskRunner(address=place.address, init_kwargs=None if place.address else local)
    deaths = (
        exceptions.WorkerCrashedError,
        exceptions.NodeDiedError,
        exceptions.OutOfMemoryError,
        exceptions.ObjectLostError,
    )
    return runner, deaths, remote_options(max_retries=MOST_DEATHS), lambda _: None


_RUNNERS: Mapping[str, Callable[[Workplace], _Started]] = {"threads": _threads, "dask": _dask, "ray": _ray}


def _server_of(place: Workplace) -> str:
    """Where workers report to. An embedded server is told to them too: each would start one of its own."""
    context = FlowRunContext.get()
    if context is None:
        raise UsageError("a crew of tasks works within a flow only; `demoplan run --workers` needs none")
    url = str(context.client.api_url)
    if place.address and not _is_here(place.address) and _is_here(url):
        raise UsageError(
            f"workers at {place.address} cannot reach Prefect's server at {url}; run `prefect server start` "
            "where they can, and set PREFECT_API_URL"
        )
    return url


def _is_here(address: str) -> bool:
    """Whether an address is one of this machine alone."""
    host = urlsplit(address if "//" in address else f"//{address}").hostname
    try:
        return host is None or host == "localhost" or ip_address(host).is_loopback
    except ValueError:
        return host == "auto"
