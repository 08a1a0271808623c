"""What random loops of every family share: plants, random chains and rates, exact radii of positive maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from scipy.linalg import expm, solve_discrete_are
from scipy.sparse.linalg import LinearOperator, eigs

from design.controllers import LoopModel
from design.controllers.scheduled_gain import ScheduledGain
from design.processes.delay_chain import DelayChain
from design.requests.scheduled import scheduled_of
from hil.certify import CertificationProblem
from plants import JumpModel, JumpRates, Signal, StateSpace

Array = np.ndarray[Any, Any]


@dataclass(frozen=True, kw_only=True)
class Flat:
    """A plant that is its linear model."""

    n: int = 1
    inputs: ClassVar[tuple[Signal, ...]] = (Signal("u", "1"),)
    states: ClassVar[tuple[Signal, ...]] = (Signal("x", "1"),)

    @property
    def outputs(self) -> tuple[Signal, ...]:
        return self.states

    def model(self) -> StateSpace:
        raise NotImplementedError

    def start(self, rng: np.random.Generator) -> Any:
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Jumping(Flat):
    system: JumpModel
    process: JumpRates

    def jump_system(self) -> JumpModel:
        return self.system

    def jump_process(self) -> JumpRates:
        return self.process


def rows(matrix: Array) -> Any:
    return tuple(tuple(map(float, row)) for row in matrix)


def radius(move: Callable[[Array], Array], start: Array) -> float:
    """Spectral radius of a positive map on families of symmetric matrices."""

    def apply(flat: Array) -> Array:
        M = flat.reshape(start.shape)
        return np.asarray(move(0.5 * (M + M.transpose(0, 2, 1)))).ravel()

    if start.size <= 80:
        return float(np.abs(np.linalg.eigvals(np.array([apply(e) for e in np.eye(start.size)]))).max())
    operator = LinearOperator((start.size, start.size), matvec=apply, dtype=float)
    return float(np.abs(eigs(operator, k=1, v0=start.ravel(), tol=1e-10, maxiter=20000, return_eigenvectors=False))[0])


def chain(rng: np.random.Generator, modes: int) -> Array:
    P = rng.dirichlet(np.full(modes, 0.7), modes)
    return P / P.sum(axis=1, keepdims=True)


def jump_matrices(rng: np.random.Generator, modes: int, n: int) -> tuple[Array, Array, Array]:
    A = rng.normal(size=(n, n)) + rng.normal(scale=0.3, size=(modes, n, n)) + rng.uniform(-0.5, 1.5) * np.eye(n)
    B = np.ones((n, 1)) + rng.normal(scale=0.4, size=(modes, n, 1))
    T = float(rng.choice([0.01, 0.05, 0.2]))
    gains = []
    for a, b in zip(A, B, strict=True):
        F, G = flow(a, b, T)
        P = solve_discrete_are(F, G, np.eye(n), 0.1 * np.eye(1))
        gains.append(-np.linalg.solve(0.1 + G.T @ P @ G, G.T @ P @ F))
    drift = A + rng.normal(scale=float(rng.choice([0.0, 0.3, 1.5])), size=A.shape)
    return drift, B * rng.uniform(0.5, 1.3), np.array(gains) * rng.uniform(0.6, 1.4)


def flow(a: Array, b: Array, T: float) -> tuple[Array, Array]:
    n, m = b.shape
    both = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * T)
    return both[:n, :n], both[:n, n:]


def held(a: Array, b: Array) -> Array:
    n, m = b.shape
    return np.block([[a, b], [np.zeros((m, n + m))]])


def rates_of(rng: np.random.Generator, modes: int) -> Array:
    Q = rng.exponential(float(rng.choice([0.3, 3.0])), (modes, modes)) * (1 - np.eye(modes))
    return Q - np.diag(Q.sum(axis=1))


def jump_loop(
    rng: np.random.Generator, system: JumpModel, process: JumpRates, K: Array, T: float, late: int
) -> CertificationProblem:
    tau = int(rng.integers(0, late + 1))
    n = len(system.A[0])
    model = LoopModel(
        A=np.eye(n), B=np.zeros((n, 1)), C=np.eye(n + 1, n), period_s=T, tau_max=tau, d_max=late - tau
    )  # fmt: skip
    gain = ScheduledGain(gain=K[:, None], starts_s=np.zeros((len(K), 1)))
    constant = [DelayChain(transition=[[1.0]], delays=[delay]) for delay in (tau, late - tau)]
    plant = Jumping(system=system, process=process)
    return CertificationProblem(
        plant=plant, controller=scheduled_of(gain), model=model, sc=constant[0], ca=constant[1], digest="study"
    )
