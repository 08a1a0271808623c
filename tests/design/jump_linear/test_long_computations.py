"""What computes long in C is ended by Ctrl-C, and by nothing else."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csc_array

from design.jump_linear import long_computations as room
from design.jump_linear import stability_proof
from design.jump_linear.long_computations import apart, interruptible, spectral_radius
from tests.waiting import until


def test_ctrl_c_comes_while_the_computation_goes_on() -> None:
    over, begun, ended = threading.Event(), threading.Event(), threading.Event()

    def compute() -> Any:
        assert threading.current_thread() is not threading.main_thread()
        begun.set()
        over.wait()  # as long as the test has not seen the interrupt
        ended.set()
        return np.zeros(1)

    threading.Thread(target=lambda: begun.wait() and os.kill(os.getpid(), signal.SIGINT), daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        interruptible(compute)
    assert not ended.is_set()
    over.set()


def test_what_it_returns_and_raises_is_the_computations_own() -> None:
    assert spectral_radius(np.array([[0.0, 2.0], [-3.0, 0.0]])) == pytest.approx(6**0.5)
    with pytest.raises(np.linalg.LinAlgError):
        spectral_radius(np.full((2, 2), np.nan))


def test_all_eigenvalues_of_a_large_operator_are_computed_beside_the_main_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    threads: list[bool] = []

    def seen(compute: Callable[..., Any]) -> Callable[..., Any]:
        def called(*args: Any) -> Any:
            threads.append(threading.current_thread() is threading.main_thread())
            return compute(*args)

        return called

    monkeypatch.setattr(room.np.linalg, "eigvals", seen(np.linalg.eigvals))
    assert spectral_radius(np.eye(2)) == 1.0
    assert threads == [False]


def test_what_may_not_be_left_behind_is_computed_in_a_copy_that_ctrl_c_ends(tmp_path: Path) -> None:
    begun = tmp_path / "begun"

    def compute() -> Any:
        (tmp_path / "now").write_text(str(os.getpid()))
        (tmp_path / "now").rename(begun)
        while True:  # as SuperLU, it looks at no signal
            signal.sigpending()

    def interrupt() -> None:
        until(begun.exists, "the copy computes")
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        apart(compute)
    assert int(begun.read_text()) != os.getpid()
    with pytest.raises(ProcessLookupError):
        os.kill(int(begun.read_text()), 0)


def test_ctrl_c_that_comes_while_the_copy_is_made_is_not_lost() -> None:
    """Python prints and drops what is raised in what it calls after a fork, as logging's locks are given back."""
    interrupts: list[int] = []

    def interrupt() -> None:
        if interrupts:
            signal.raise_signal(interrupts.pop())

    os.register_at_fork(after_in_parent=interrupt)
    interrupts.append(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        apart(lambda: np.zeros(1))
    assert not interrupts and apart(lambda: np.ones(1)).tolist() == [1.0]
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_what_a_copy_computes_comes_back_and_what_it_raises_is_no_number() -> None:
    assert apart(lambda: np.arange(6.0).reshape(2, 3)).tolist() == [[0.0, 1.0, 2.0], [3.0, 4.0, 5.0]]
    with pytest.raises(np.linalg.LinAlgError, match="came to no end"):
        apart(lambda: np.array([{}["x"]]))


def test_a_large_factorisation_is_made_apart_with_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    operator = csc_array(np.where(rng.random((60, 60)) < 0.1, rng.normal(size=(60, 60)), 0.0))
    right, made = rng.normal(size=60), []

    def seen(compute: Callable[[], Any]) -> Any:
        made.append(0)
        return apart(compute)

    monkeypatch.setattr(stability_proof, "apart", seen)
    here = stability_proof.solve_sparse(operator, right)
    assert not made
    monkeypatch.setattr(stability_proof, "QUICK", 100)
    assert stability_proof.solve_sparse(operator, right).tolist() == here.tolist() and made == [0]
    assert np.isnan(stability_proof.solve_sparse(csc_array(np.eye(400)), np.ones(400))).all()  # singular
