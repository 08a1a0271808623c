"""Chapter 5: control from the historical data of scheduled sensors.

A plant with several state delays is measured by sensor nodes that share a network. A node keeps a buffer and sends all of it
when its turn comes, so that the controller knows some of the past of every state: which part depends on the schedule.

Under scheduled gains the delayed plant is a jump-linear system on the stacked state: with X(k) = (x(k), x(k-1), ..., x(k-tau))
the loop (5.5) is X(k+1) = L_i X(k), where phase i follows a chain: a cycle for a fixed schedule, any stochastic matrix for a
random one. Everything that follows from Lyapunov equations is exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from msgspec import Struct

from design.errors import FieldError, NotStable
from design.jump_linear.order_of_modes import periodic_cost, periodic_radius
from design.jump_linear.second_moment import backward, forward

Array = npt.NDArray[np.float64]
SWEEPS = 20_000
TOLERANCE = 1e-13
LARGE = 64  # phases from which a Krylov method is quicker than sweeps
LOOKS = 4  # sweeps from one look at what they change to the next


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DelayedPlant:
    """The plant (5.1) and the weights of its cost (5.3), (5.18).

    Args:
        A: (n, n).
        delayed: (tau, n, n), the matrices of x(k - 1), ..., x(k - tau).
        B: (n, p).
        weight: Xi, (n, n).
        input_weight: Xi_u, (p, p); default 0.
        input_delay: slots from a command to its effect on the plant; before the first the input is 0.

    Raises:
        ValueError: shapes that do not fit; the message begins with the field.
    """

    A: Array
    delayed: Array
    B: Array
    weight: Array
    input_weight: Array | None = None
    input_delay: int = 0

    def __post_init__(self) -> None:
        n, p = self.A.shape[0], self.B.shape[-1]
        expected = {"A": (n, n), "delayed": (len(self.delayed), n, n), "B": (n, p), "weight": (n, n)}
        for name, shape in expected.items():
            if getattr(self, name).shape != shape:
                raise FieldError(name, f"shape {list(getattr(self, name).shape)}, expected {list(shape)}")
        if self.input_weight is not None and self.input_weight.shape != (p, p):
            raise FieldError("input_weight", f"shape {list(self.input_weight.shape)}, expected {[p, p]}")

    @property
    def memory(self) -> int:
        """tau, the largest state delay."""
        return len(self.delayed)

    def matrices(self, memory: int) -> tuple[Array, Array, Array, Array]:
        """Return A~, B~, Xi~ and Xi_u on the stacked state: ``memory`` + 1 samples, then the commands under way, newest first."""
        n, p = self.B.shape
        first = n * (memory + 1)  # of the commands
        size = first + self.input_delay * p
        A, B, weight = np.zeros((size, size)), np.zeros((size, p)), np.zeros((size, size))
        A[:n, :n] = self.A
        for j, matrix in enumerate(self.delayed, start=1):
            A[:n, n * j : n * (j + 1)] = matrix
        A[n:first, : first - n] = np.eye(first - n)
        if self.input_delay:
            A[:n, size - p :], B[first : first + p] = self.B, np.eye(p)
            A[first + p :, first : size - p] = np.eye(size - first - p)
        else:
            B[:n] = self.B
        weight[:n, :n] = self.weight
        return A, B, weight, np.zeros((p, p)) if self.input_weight is None else self.input_weight

    def with_ages(self, memory: int, ages: npt.NDArray[np.int64]) -> tuple[Array, Array, Array, Array, Array]:
        r"""Return A~_i, B~_i, Xi~, E_i and F_i where the command that acts is of another age in every phase i.

        It is one of those under way or, where none has come, what acted in the slot before, which is the last entry of the state:
        v(k) = E_i X(k) + F_i u(k).

        Args:
            memory: as of `matrices`.
            ages: of the command that acts, (phases,), slots; -1 where the actuator holds what acted before.
        """
        n, p = self.B.shape
        first, oldest = n * (memory + 1), max(int(ages.max()), 0)
        size = first + p * (oldest + 1)  # the commands under way, then what acted before
        A, B, E, F = (np.zeros((len(ages), *shape)) for shape in ((size, size), (size, p), (p, size), (p, p)))
        A[:, :first, :first] = replace(self, input_delay=0).matrices(memory)[0]
        under_way = slice(first, first + p * oldest)
        A[:, under_way, under_way] = np.eye(p * oldest, k=-p)
        B[:, first : first + p] = np.eye(p) if oldest else 0.0
        for i, age in enumerate(ages.tolist()):
            if age == 0:
                F[i] = np.eye(p)
            else:
                at = size - p if age < 0 else first + p * (age - 1)
                E[i, :, at : at + p] = np.eye(p)
        for rows, M in ((slice(n), self.B), (slice(size - p, size), np.eye(p))):
            A[:, rows] += M @ E
            B[:, rows] += M @ F
        weight = np.zeros((size, size))
        weight[:n, :n] = self.weight
        return A, B, weight, E, F


class LiftedLoop(Struct, frozen=True, kw_only=True, eq=False):
    """A closed loop: one matrix a phase, the chain of the phases, and the cost per slot.

    Args:
        L: (phases, N, N).
        Q: (phases, N, N), the cost of a slot, X' Q_i X.
        transition: (phases, phases), row-stochastic.
    """

    L: Array
    Q: Array
    transition: Array

    @property
    def cyclic(self) -> bool:
        """Whether phase i is followed by phase i + 1, and the last by the first."""
        return bool(np.array_equal(self.transition, cycle(len(self.L))))

    def radius(self) -> float:
        """Return the growth of E|X|^2 per slot: below 1 the loop is (mean-square) stable, and only then."""
        return periodic_radius(self.L, self.transition)

    def cost_to_go(self, guess: Array | None = None) -> Array:
        """Return S with E sum of X'Q X from a slot of phase i on = X' S_i X: S_i = Q_i + L_i' E_i(S) L_i.

        Args:
            guess: (phases, N, N), positive semidefinite and near the answer: over a random chain it is found sooner.

        Raises:
            NotStable: the sum has no end.
        """
        if not self.cyclic:
            return self._fixed_point(lambda S: self.Q + backward(self.L, self.transition, S), guess)
        return _around(self.L, self.Q)

    def stable_cost_to_go(self) -> Array:
        """Return what `cost_to_go` does, where the radius is known to be below 1: over many phases it is found sooner.

        Raises:
            NotStable: the radius is so near 1 that it was not found.
        """
        return periodic_cost(self.L, self.transition, self.Q) if len(self.L) >= LARGE and not self.cyclic else self.cost_to_go()

    def gramian(self, start: Array, guess: Array | None = None) -> Array:
        """Return G_i, the sum over all slots of phase i of E X X'.

        Args:
            start: (phases, N, N), E X(0)X(0)' in each phase.
            guess: (phases, N, N), positive semidefinite and near the answer: over a random chain it is found sooner.

        Raises:
            NotStable: the sum has no end.
        """
        if not self.cyclic:
            return self._fixed_point(lambda G: start + forward(self.L, self.transition, G), guess)
        back = -np.arange(len(self.L)) % len(self.L)  # what starts in phase -k comes to phase 0 after k slots
        return _around(self.L[back - 1].transpose(0, 2, 1), start[back])[back]

    def _fixed_point(self, step: Callable[[Array], Array], guess: Array | None) -> Array:
        value = np.zeros_like(self.Q) if guess is None else guess
        with np.errstate(over="ignore", invalid="ignore"):  # what grows beyond all numbers is not stable
            for _ in range(SWEEPS // LOOKS):
                for _ in range(LOOKS - 1):
                    value = step(value)
                new = step(value)
                largest = np.abs(new).max()
                if not np.isfinite(largest):
                    break
                if np.abs(new - value).max() <= TOLERANCE * largest:
                    return new
                value = new
        raise NotStable("the cost has no finite sum: the loop is not mean-square stable")


def close(
    plant: DelayedPlant, gains: Array, transition: Array | None = None, *, renewed: npt.NDArray[np.bool_] | None = None,
    ages: npt.NDArray[np.int64] | None = None,
) -> LiftedLoop:  # fmt: skip
    """Return the loop (5.5) of a plant under gains.

    Args:
        plant: the plant.
        gains: K, (phases, memory + 1, p, n): u(k) = sum_j K[i, j] x(k - j), and K[i, memory + 1] h(k) where ``renewed`` is given.
        transition: chain of the phases; default the cycle (5.2).
        renewed: (phases, n), whether a held sample h_l becomes x_l(k - memory), the last entries of the state; default none held.
        ages: of the command that acts, (phases,), as of `DelayedPlant.with_ages`; default the plant's own in every phase.
    """
    phases, columns, p, n = gains.shape
    columns -= renewed is not None
    memory = max(columns - 1, plant.memory)
    A, B, weight, input_weight = plant.matrices(memory)
    if ages is not None:
        A, B, weight, E, F = plant.with_ages(memory, ages)
    K = np.zeros((phases, p, A.shape[-1]))
    K[:, :, : n * columns] = gains[:, :columns].transpose(0, 2, 1, 3).reshape(phases, p, n * columns)
    if renewed is not None:
        A, more = with_held(A, renewed, n * (columns - 1)), ((0, n), (0, 0))
        B, weight = np.pad(B, (*((0, 0),) * (B.ndim - 2), *more)), np.pad(weight, (0, n))
        K = np.concatenate([K, gains[:, columns]], axis=2)
    L = A + B @ K
    acts = K if ages is None else np.pad(E, ((0, 0), (0, 0), (0, K.shape[2] - E.shape[2]))) + F @ K
    Q = weight + acts.transpose(0, 2, 1) @ input_weight @ acts
    return LiftedLoop(L=L, Q=Q, transition=cycle(phases) if transition is None else np.asarray(transition, dtype=float))


def with_held(A: Array, renewed: npt.NDArray[np.bool_], oldest: int) -> Array:
    """Return A with n entries below that stay, or become those from ``oldest`` on where renewed: (phases, N + n, N + n)."""
    (phases, n), size = renewed.shape, A.shape[-1]
    found = np.zeros((phases, size + n, size + n))
    found[:, :size, :size] = A
    i, l = np.indices(renewed.shape)
    found[i, size + l, np.where(renewed, oldest + l, size + l)] = 1.0
    return found


def cycle(phases: int) -> Array:
    """Return the transition matrix of the cycle, Lambda of Remark 5.3."""
    return np.roll(np.eye(phases), 1, axis=1)


def _around(L: Array, Q: Array) -> Array:
    """Return S with S_i = Q_i + L_i' S_(i+1) L_i around the cycle."""
    product, total, S = np.eye(L.shape[-1]), np.zeros_like(Q[0]), np.zeros_like(Q)
    for own, weight in zip(L, Q):
        total = total + product.T @ weight @ product
        product = own @ product
    S[0] = after = _series(product, total)
    for i in range(len(L) - 1, 0, -1):
        S[i] = after = Q[i] + L[i].T @ after @ L[i]
    return S


def _series(M: Array, W: Array) -> Array:
    """Return the sum of M'^t W M^t over t >= 0, by doubling."""
    total, power = W, M
    with np.errstate(over="ignore", invalid="ignore"):  # what grows beyond all numbers is not stable
        for _ in range(64):
            added = power.T @ total @ power
            if not np.isfinite(added).all():
                break
            total = total + added
            if np.abs(added).max() <= 1e-17 * np.abs(total).max():
                return np.asarray(0.5 * (total + total.T))
            power = power @ power
    raise NotStable("the cost has no finite sum: the loop is not stable")
