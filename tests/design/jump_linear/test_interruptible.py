"""What computes long in C is ended by Ctrl-C, and by nothing else."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from design.jump_linear import interruptible as room
from design.jump_linear.interruptible import interruptible, spectral_radius


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
