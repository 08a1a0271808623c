"""One core, all cores, many machines: the same bits. The many machines are a real dask cluster of two processes on loopback."""

from __future__ import annotations

import os
import signal
import warnings
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from design.as_printed import CHAPTER2_START, chapter2_gain, chapter2_system
from design.errors import DesignError
from design.jump_linear import MJLS
from design.monte_carlo import CHAIN, JUMPS, DrawTable, Workers, _cancel, spread, uniforms
from design.monte_carlo.jump_loop import JumpLoop
from design.monte_carlo.studies import CHUNK, mean_states, mjls_energies, settling_times
from design.processes.rates import WeibullRate
from design.processes.semi_markov import SemiMarkov
from tests.waiting import LIMIT_S

# Newton's iteration, whose number of steps depends on all members of a batch: the hard case for equal bits.
RATE = WeibullRate(scale_s=1.0, shape=1.7)
LOOP = JumpLoop(
    system=chapter2_system("printed"),
    gain=chapter2_gain(),
    process=SemiMarkov(rates=((None, RATE), (RATE, None))),
    start=CHAPTER2_START,
    uncertain=True,
)
RUNS = 3 * CHUNK + 100
ONE_CORE = Workers()


@pytest.fixture(scope="module")
def cluster() -> Iterator[str]:
    """The address of a scheduler with two worker processes, all on 127.0.0.1, no dashboard; stopped at the end."""
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address=None, silence_logs=50
    ) as local:
        local.wait_for_workers(2, timeout=LIMIT_S)
        yield local.scheduler_address


def workers_of(request: pytest.FixtureRequest, name: str) -> Workers:
    if name == "dask":
        return Workers(backend="dask", scheduler=request.getfixturevalue("cluster"))
    return Workers(backend=name, jobs=3)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def alone() -> np.ndarray:
    return settling_times(LOOP, RUNS, duration_s=3.0, seed=4)


def test_any_split_into_batches_gives_the_same_bits(alone: np.ndarray) -> None:
    cuts = [0, 1, 40, CHUNK, CHUNK + 1, 2 * CHUNK + 17, RUNS]
    parts = [
        settling_times(LOOP, b - a, duration_s=3.0, seed=4, first=a) for a, b in pairwise(cuts)
    ]
    np.testing.assert_array_equal(np.concatenate(parts), alone)
    assert np.unique(alone).size > 100  # the runs are not one run


@pytest.mark.parametrize("backend", ["threading", "loky", pytest.param("dask", marks=pytest.mark.slow)])
def test_every_backend_gives_the_same_bits(request: pytest.FixtureRequest, backend: str, alone: np.ndarray) -> None:
    workers = workers_of(request, backend)
    np.testing.assert_array_equal(settling_times(LOOP, RUNS, duration_s=3.0, seed=4, workers=workers), alone)
    one, many = (mean_states(LOOP, RUNS, duration_s=1.0, seed=4, workers=each) for each in (ONE_CORE, workers))
    np.testing.assert_array_equal(one, many)


@pytest.mark.parametrize("backend", ["loky", pytest.param("dask", marks=pytest.mark.slow)])
def test_every_backend_gives_the_same_bits_in_discrete_time(request: pytest.FixtureRequest, backend: str) -> None:
    rng = np.random.default_rng(0)
    system = MJLS(A=rng.normal(size=(3, 6, 6)) / 4, B=np.eye(6), C=np.eye(6), transition=rng.dirichlet(np.ones(3), 3))
    one, many = (
        mjls_energies(system, 1500, 30, start=np.ones(6), seed=2, workers=each)
        for each in (ONE_CORE, workers_of(request, backend))
    )
    np.testing.assert_array_equal(one, many)


def process_of(_: int) -> int:
    return os.getpid()


@pytest.mark.slow
def test_the_cluster_really_is_two_other_processes(cluster: str) -> None:
    from distributed import Client

    with Client(cluster, set_as_default=False, timeout=LIMIT_S) as client:
        workers = set(client.run(os.getpid).values())
    assert len(workers) == 2
    assert os.getpid() not in workers
    assert set(spread(process_of, range(8), Workers(backend="dask", scheduler=cluster))) <= workers


def test_results_come_in_order_and_an_error_in_a_job_is_raised() -> None:
    def reciprocal(k: int) -> float:
        return 1.0 / (k - 3)

    assert list(spread(abs, range(20), Workers(backend="loky", jobs=2))) == list(range(20))
    with pytest.raises(ZeroDivisionError):
        list(spread(reciprocal, range(6), Workers(backend="threading", jobs=2)))


@pytest.mark.parametrize("said", [
    "3 tasks which were still being processed by the workers have been cancelled.",
    "2 tasks have been successfully executed  but not used. Additionally, 3 tasks which were still being processed",
])  # fmt: skip
def test_a_warning_of_joblib_about_unused_results_is_not_passed_on(said: str, recwarn: pytest.WarningsRecorder) -> None:
    def results() -> Iterator[int]:
        try:
            yield 0
        finally:
            warnings.warn(said, stacklevel=1)

    left = results()
    next(left)
    _cancel(left)
    assert not recwarn.list


class Interrupted(list[int]):
    """Jobs; Ctrl-C comes while the first of them is given out, and with it the workers are started."""

    def __iter__(self) -> Iterator[int]:
        os.kill(os.getpid(), signal.SIGINT)
        yield from super().__iter__()


# A thread of joblib's may still hand out the work that was given up.
@pytest.mark.filterwarnings("ignore:Exception in thread ExecutorManagerThread:pytest.PytestUnhandledThreadExceptionWarning")
def test_an_interrupt_while_workers_are_started_is_not_lost() -> None:
    with pytest.raises(KeyboardInterrupt):
        list(spread(abs, Interrupted(range(8)), Workers(backend="loky", jobs=2)))
    assert list(spread(abs, range(4), Workers(backend="loky", jobs=2))) == list(range(4))


def blocks_interrupts(_: int) -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ())


def test_an_interrupt_of_the_terminal_is_for_the_parent_alone() -> None:
    assert not blocks_interrupts(0)
    assert all(spread(blocks_interrupts, range(4), Workers(backend="loky", jobs=3)))


def test_a_scheduler_that_is_not_there_is_said() -> None:
    workers = Workers(backend="dask", scheduler="tcp://127.0.0.1:9", connect_timeout_s=0.5)
    with pytest.raises(DesignError, match=r"^scheduler: no dask scheduler answers at tcp://127.0.0.1:9"):
        list(spread(abs, [1], workers))


@pytest.mark.parametrize("address", ["garbage", "foo://x:1", "tcp://", ""])
def test_what_is_no_address_of_a_scheduler_makes_no_client(monkeypatch: pytest.MonkeyPatch, address: str) -> None:
    monkeypatch.setattr("distributed.Client", lambda *_, **__: pytest.fail("a client was made, and takes seconds to close"))
    with pytest.raises(DesignError, match=f"^scheduler: no dask scheduler answers at {address} "):
        list(spread(abs, [1], Workers(backend="dask", scheduler=address)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"backend": "ray"}, "backend: 'ray'"),
        ({"jobs": 0}, "jobs: 0"),
        ({"backend": "dask"}, "scheduler: None"),
        ({"scheduler": "tcp://127.0.0.1:1"}, "scheduler: 'tcp"),
    ],
)
def test_workers_that_cannot_be_is_refused(change: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match="^" + message):
        Workers(**change)  # type: ignore[arg-type]


def test_a_run_has_its_numbers_whatever_else_is_drawn() -> None:
    whole = uniforms(3, 0, 500, blocks=4, purpose=JUMPS, page=2)
    for first, runs in ((0, 1), (17, 40), (499, 1)):
        part = uniforms(3, first, runs, blocks=4, purpose=JUMPS, page=2)
        np.testing.assert_array_equal(part, whole[:, first : first + runs])


def test_pages_continue_a_stream() -> None:
    table = DrawTable(1, 10, 5, purpose=JUMPS, blocks=2)
    rows = np.stack([table.row(k) for k in range(20)])
    pages = [uniforms(1, 10, 5, blocks=2, purpose=JUMPS, page=p) for p in range(3)]
    np.testing.assert_array_equal(rows, np.concatenate(pages)[:20])


def test_no_two_streams_share_a_number_and_all_are_uniform() -> None:
    parts = [
        uniforms(seed, 0, 2000, blocks=4, purpose=purpose, page=page).ravel()
        for seed in (0, 1)
        for purpose in (JUMPS, CHAIN)
        for page in (0, 1)
    ]
    every = np.concatenate(parts)
    # 256,000 draws of 52 bits: a coincidence has probability 7e-6.
    assert np.unique(every).size == every.size
    assert every.min() > 0.0
    assert every.max() < 1.0
    assert all(stats.kstest(part, "uniform").pvalue > 1e-3 / len(parts) for part in parts)


def test_consecutive_runs_are_uncorrelated() -> None:
    u = uniforms(9, 0, 20_000, blocks=1, purpose=JUMPS)
    for row in u:
        assert abs(np.corrcoef(row[:-1], row[1:])[0, 1]) < 4.0 / np.sqrt(20_000)


def test_bad_addresses_are_refused() -> None:
    with pytest.raises(ValueError, match=r"^seed: -1"):
        uniforms(-1, 0, 1, blocks=1, purpose=JUMPS)
    with pytest.raises(ValueError, match=r"^runs: "):
        uniforms(1, -1, 1, blocks=1, purpose=JUMPS)
