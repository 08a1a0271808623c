"""Thousands of runs at once: paths, batches, seeds, parallel back ends, confidence.

The numbers are the same however many runs are split over cores and machines. A stream of random numbers is addressed by (seed,
run, draw), see `uniforms`; runs are computed in chunks that are always cut at the same places, see `spread`.
"""

from __future__ import annotations

import os
import signal
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import ExitStack, contextmanager, nullcontext
from importlib import import_module
from typing import Any, Final, Literal, TypeVar, get_args

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.errors import DesignError, FieldError

FloatArray = npt.NDArray[np.float64]

JUMPS, PARAMETERS, CHAIN = range(3)
"""What a stream is for."""


def uniforms(seed: int, first: int, runs: int, *, blocks: int, purpose: int, page: int = 0) -> FloatArray:
    """Uniform numbers of the runs first, ..., first + runs - 1: shape (4 blocks, runs), all strictly between 0 and 1.

    The streams are cut out of one counter-based generator (Philox4x64-10, numpy's). A run owns ``blocks`` consecutive
    values of the counter's lowest word; the second word counts pages, for runs that need more; the third says what the
    numbers are for:

        counter = (run * blocks + b, page, purpose, 0),   key = SeedSequence(seed),   4 numbers of 64 bits per value.

    So the streams of consecutive runs are consecutive output, which one call fetches for a whole batch: making a generator
    for every run (SeedSequence.spawn) costs 15 us a run, which is more than the run itself takes.

    ``random_raw`` is used and not a Generator method, because numpy promises the former's output for ever.

    >>> whole = uniforms(7, 0, 100, blocks=2, purpose=JUMPS)
    >>> bool((whole[:, 60:63] == uniforms(7, 60, 3, blocks=2, purpose=JUMPS)).all())
    True
    """
    if seed < 0:
        raise FieldError("seed", f"{seed} is negative")
    if first < 0 or runs < 0:
        raise FieldError("runs", f"{runs} from number {first}, expected numbers >= 0")
    key = np.random.SeedSequence(seed).generate_state(2, np.uint64)
    counter = np.array([first * blocks, page, purpose, 0], dtype=np.uint64)
    raw = np.random.Philox(key=key, counter=counter).random_raw(4 * blocks * runs)
    # 52 bits and a half: never 0 and never 1, so that logarithms and normal quantiles stay finite.
    unit = ((raw >> np.uint64(12)) + 0.5) * 2.0**-52
    return np.ascontiguousarray(unit.reshape(runs, 4 * blocks).T)


class DrawTable:
    """The draws 0, 1, 2, ... of a batch of runs, fetched page by page as they are asked for.

    Args:
        seed, first, runs: which streams.
        purpose: one of the above.
        blocks: size of a page, fixed for a purpose.
    """

    def __init__(self, seed: int, first: int, runs: int, *, purpose: int, blocks: int) -> None:
        self._seed, self._first, self._runs = seed, first, runs
        self._purpose, self._blocks = purpose, blocks
        self._page = -1
        self._values = np.empty((0, runs))

    def row(self, draw: int) -> FloatArray:
        """Draw number ``draw`` of every run, shape (runs,)."""
        page, at = divmod(draw, 4 * self._blocks)
        if page != self._page:
            self._values = uniforms(self._seed, self._first, self._runs, blocks=self._blocks, purpose=self._purpose, page=page)
            self._page = page
        return np.asarray(self._values[at])


_SAFE = "PYTHONSAFEPATH"


@contextmanager
def safe_path() -> Iterator[None]:
    """Start workers without the working folder on their path, where a ``pickle.py`` would stand before the standard library's.

    Workers and resource trackers of joblib, multiprocessing and dask start as ``python -m`` or ``python -c``, which put it
    there. A worker is then given the path of this process, so that what is found here is found there.
    """
    before = os.environ.get(_SAFE)
    os.environ[_SAFE] = "1"
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(_SAFE, None)
        else:
            os.environ[_SAFE] = before


KILLED: Final = "a worker process ended before its work was done: memory ran out, it was killed, or a plug-in ended it"
Backend = Literal["serial", "loky", "threading", "dask"]
Result = TypeVar("Result")
Job = TypeVar("Job")


class Workers(Struct, frozen=True, kw_only=True):
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


ONE_CORE: Final = Workers()


def in_chunks(
    task: Callable[[int], Result], first: int, runs: int, size: int, workers: Workers = ONE_CORE
) -> Iterator[tuple[slice, Result]]:
    """Results of task(chunk) for the chunks that hold the runs first, ..., in order, each with which of its runs are among these.

    Args:
        task: computes a chunk of ``size`` runs by its number.
        first, runs, size: which runs, and how many a chunk has.
        workers: who computes.

    Raises:
        FieldError: no runs, or a number below 0.
    """
    if runs < 1 or first < 0:
        raise FieldError("runs", f"{runs} from number {first}, expected at least one from number 0 on")
    chunks = range(first // size, (first + runs - 1) // size + 1)
    for chunk, result in zip(chunks, spread(task, chunks, workers)):
        yield inside_chunk(chunk, first, runs, size), result


def spread(task: Callable[[Job], Result], jobs: Sequence[Job], workers: Workers) -> Iterator[Result]:
    """Results of task(job) for every job, in order, each as soon as it and those before it are there.

    The runs are cut into chunks by their number, always at the same places. A chunk is computed the same way wherever it is
    computed, so no split into jobs can change a bit of the result: not by vector units that treat the ends of an array
    differently, not by an iteration that stops when all members of a batch have converged. Draws and motions use plain operations
    alone (`design.processes`), so that processors of different instruction sets agree, too.

    Closing the iterator (or Ctrl-C) cancels what has not begun.

    Raises:
        DesignError: the dask scheduler does not answer, or a process ended before its work was done.
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
        with _interrupts_wait() if workers.backend == "loky" else nullcontext():
            run = Parallel(batch_size=1, return_as="generator")
            results = run(delayed(task)(job) for job in jobs)
            stack.callback(_cancel, results)
        try:
            yield from results
        except BrokenExecutor as error:
            raise DesignError(KILLED) from error


def _cancel(results: Any) -> None:
    """Close the results, which cancels what runs: joblib warns of that, and it is what is asked for."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "[0-9]+ tasks (which were still being processed|have been successfully)", UserWarning)
        results.close()


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Let Ctrl-C wait for the milliseconds in which workers are started; it comes when they all are there.

    A terminal sends it to all of them; it is for this process alone, which then stops them. They inherit the mask for good. The
    two resource trackers are started first: they lift the mask of who starts them.
    """
    for tracker in ("joblib.externals.loky.backend.resource_tracker", "multiprocessing.resource_tracker"):
        import_module(tracker).ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT,))
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


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


def inside_chunk(chunk: int, first: int, runs: int, size: int) -> slice:
    """Which of a chunk's runs are among the runs first, ..., first + runs - 1."""
    return slice(max(first - chunk * size, 0), min(first + runs - chunk * size, size))
