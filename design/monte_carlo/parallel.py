"""Where a Monte Carlo study is computed: one core, all cores, many machines, with the same numbers on all of them.

The runs are cut into chunks by their number, always at the same places. A chunk is computed the same way wherever it is
computed, so no split into jobs can change a bit of the result: not by vector units that treat the ends of an array
differently, not by an iteration that stops when all members of a batch have converged. Between processors of different
instruction sets the logarithm of the C library may differ in its last digit.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Literal, TypeVar, get_args

from design.errors import DesignError, FieldError
from design.monte_carlo.safe_path import safe_path

Backend = Literal["serial", "loky", "threading", "dask"]
Result = TypeVar("Result")
Job = TypeVar("Job")


@dataclass(frozen=True, slots=True, kw_only=True)
class Workers:
    """Where the runs are computed.

    Args:
        backend: ``serial`` (this process), ``loky`` (processes on this machine), ``threading``, ``dask`` (many machines).
        jobs: processes or threads; -1 for one per core. A dask cluster uses what it has.
        scheduler: address of the dask scheduler, e.g. ``tcp://10.0.0.1:8786``; its workers need this package.
        connect_timeout_s: how long to wait for it.
    """

    backend: Backend = "serial"
    jobs: int = -1
    scheduler: str | None = None
    connect_timeout_s: float = 10.0

    def __post_init__(self) -> None:
        if self.backend not in get_args(Backend):
            raise FieldError("backend", f"{self.backend!r} is not one of {get_args(Backend)}")
        if self.jobs == 0 or self.jobs < -1:
            raise FieldError("jobs", f"{self.jobs}, expected -1 or a positive number")
        if (self.scheduler is None) == (self.backend == "dask"):
            raise FieldError(
                "scheduler",
                f"{self.scheduler!r} with backend {self.backend!r}; "
                "dask needs the address of its scheduler, the other backends take none",
            )


def spread(task: Callable[[Job], Result], jobs: Sequence[Job], workers: Workers) -> Iterator[Result]:
    """Results of task(job) for every job, in order, each as soon as it and those before it are there.

    Closing the iterator (or Ctrl-C) cancels what has not begun.

    Raises:
        DesignError: the dask scheduler does not answer.
    """
    if workers.backend == "serial" or not jobs:
        yield from map(task, jobs)
        return
    from joblib import Parallel, delayed, parallel_config

    with ExitStack() as stack:
        options: dict[str, Any] = {"backend": workers.backend, "n_jobs": workers.jobs}
        if workers.backend == "loky":
            options["inner_max_num_threads"] = 1
        if workers.backend == "dask":
            options["client"] = stack.enter_context(_client(workers))
        stack.enter_context(parallel_config(**options))
        stack.enter_context(safe_path())
        with _workers_ignore_interrupts():
            results = Parallel(return_as="generator")(delayed(task)(job) for job in jobs)
        stack.enter_context(closing(results))
        yield from results


@contextmanager
def _workers_ignore_interrupts() -> Iterator[None]:
    """Ignore Ctrl-C for the milliseconds in which workers are started: they inherit that for good.

    A terminal sends it to all of them; it is for this process alone, which then stops them. (A mask would not lose a
    signal, but loky lifts masks when it starts its resource tracker.)
    """
    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread may set handlers
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if before is None else before)


def _client(workers: Workers) -> Any:
    try:
        connect: Any = import_module("distributed").Client
        resolve: Any = import_module("distributed.comm").resolve_address
    except ImportError as error:
        raise DesignError("backend dask: the package dask[distributed] is not installed") from error
    try:
        resolve(workers.scheduler)  # first: a client of what is no address takes many seconds to close
        return connect(workers.scheduler, timeout=workers.connect_timeout_s, set_as_default=False)
    except (OSError, ValueError) as error:
        raise DesignError(f"scheduler: no dask scheduler answers at {workers.scheduler} ({error})") from error


def chunk_numbers(first: int, runs: int, size: int) -> range:
    """Numbers of the chunks of ``size`` runs that hold the runs first, ..., first + runs - 1."""
    if runs < 1 or first < 0:
        raise FieldError("runs", f"{runs} from number {first}, expected at least one from number 0 on")
    return range(first // size, (first + runs - 1) // size + 1)


def inside_chunk(chunk: int, first: int, runs: int, size: int) -> slice:
    """Which of a chunk's runs are among the runs first, ..., first + runs - 1."""
    return slice(max(first - chunk * size, 0), min(first + runs - chunk * size, size))
