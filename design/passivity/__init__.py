"""Chapter 6: a hand, a device, a delayed link, a coupler and a wall; what is passive, what is stable, how stiff it can be.

Here is the whole loop in contact as matrices: a haptic device, held by a hand, that presses on a wall over a network. It is
linear in one material, and a jump-linear system over several.

Reference: Chapter 6, (6.1), (6.2), (6.4) and Figure 6.4; delays in the state.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Final

import numpy as np
import numpy.typing as npt
from msgspec import Struct
from scipy.linalg import expm, logm

from design.controllers.rendered_wall import Coupler
from design.controllers.wall import Material
from design.errors import FieldError, check_above_zero, check_at_least_zero
from design.jump_linear import MJLS
from design.processes.delay_chain import DelayChain

Array = npt.NDArray[np.float64]

SWINGS: Final = 1e-6
"""Share of its rates by which the first row of a device may miss x' = v by rounding."""
LEAST_LEFT: Final = 1e-12
"""Of a speed at the end of a sample: of less, a model in double precision has too few digits to tell how it was lost."""


class HeldDevice(Struct, frozen=True, kw_only=True):
    """A device and the hand that holds it rigidly.

        (m + m_h) x'' + (b + b_h) x' + k_h x = u + push,     u held over a sample

    Args:
        mass_kg, damping_n_s_per_m: m above 0 and b at least 0, of the device.
        hand_mass_kg, hand_damping_n_s_per_m, hand_stiffness_n_per_m: m_h, b_h, k_h of the hand, at least 0; 0 is no hand.

    Raises:
        FieldError: where a value is out of range.
    """

    mass_kg: float
    damping_n_s_per_m: float
    hand_mass_kg: float = 0.0
    hand_damping_n_s_per_m: float = 0.0
    hand_stiffness_n_per_m: float = 0.0

    def __post_init__(self) -> None:
        check_above_zero(mass_kg=self.mass_kg)
        check_at_least_zero(
            damping_n_s_per_m=self.damping_n_s_per_m, hand_mass_kg=self.hand_mass_kg,
            hand_damping_n_s_per_m=self.hand_damping_n_s_per_m, hand_stiffness_n_per_m=self.hand_stiffness_n_per_m,
        )  # fmt: skip

    @property
    def total_damping_n_s_per_m(self) -> float:
        """b + b_h in N s/m: what the condition for the coupler may count on."""
        return self.damping_n_s_per_m + self.hand_damping_n_s_per_m

    def discretise(self, period_s: float, stiffness_n_per_m: float = 0.0, damping_n_s_per_m: float = 0.0) -> tuple[Array, Array]:
        """Return A (2, 2) and B (2,) of the state (position, speed), the force held over T.

        Args:
            period_s: T in s.
            stiffness_n_per_m, damping_n_s_per_m: of a material beside the hand.
        """
        stiffness, damping = self.hand_stiffness_n_per_m + stiffness_n_per_m, self.total_damping_n_s_per_m + damping_n_s_per_m
        held = _over_a_sample(self.mass_kg + self.hand_mass_kg, damping, stiffness, period_s)
        return held[:2, :2].copy(), held[:2, 2].copy()


@lru_cache(maxsize=16)
def _over_a_sample(mass: float, damping: float, stiffness: float, period_s: float) -> Array:
    """exp(M T) for (x, v, f)' = M (x, v, f): a map of stiffness asks for the same device at every material."""
    return np.asarray(expm(np.array([[0.0, 1.0, 0.0], [-stiffness / mass, -damping / mass, 1.0 / mass], [0.0] * 3]) * period_s))


def continuous(A: Array, B: Array, period_s: float) -> Array:
    """Return the equations of a device whose force is held: (x, v, f)' = M (x, v, f), by the matrix logarithm.

    Args:
        A, B: of one sample, shapes (2, 2) and (2, 1), for the state (position, speed).
        period_s: sample period in s.

    Returns:
        M in 1/s, shape (3, 3).

    Raises:
        FieldError: the speed is gone within a sample, or the device swings faster than half the sample rate, so that its damping
            has no value.
    """
    if not np.linalg.det(A) > LEAST_LEFT:
        raise FieldError("plant", f"its speed is gone within a sample of {period_s:g} s, so that its damping has no value")
    found = np.asarray(np.real(logm(np.block([[A, B], [np.zeros((1, 2)), np.ones((1, 1))]]))) / period_s)
    # x' = v holds of no other logarithm than the device's
    if not np.abs(found[0] - (0.0, 1.0, 0.0)).max() <= SWINGS * max(1.0, np.abs(found).max()):
        said = f"it swings faster than half the rate of samples of {period_s:g} s, so that its damping has no value"
        raise FieldError("plant", said)
    return found


class HapticLoop(Struct, frozen=True, kw_only=True):
    """A held device that presses on a wall through a coupler and a network.

    State, M the longer of coupler and force delay:

        (x, v, x(k-1) .. x(k-n1), f(k-1) .. f(k-M), x_v(k-1), q)

    The controller has x(k - n1) in slot k, the device feels f(k - n2). In contact f = K x_v + B (x_v(k) - x_v(k-1))/T and
    x_v = x(k - n1) - (C f)(k), both solved for f(k); q is the state of the coupler's integrator.

    Args:
        device: device and hand.
        coupler: C.
        period_s: T in s.
        sc_max, ca_max: largest delays n1 of the position and n2 of the force, samples: they size the state.
    """

    device: HeldDevice
    coupler: Coupler
    period_s: float
    sc_max: int
    ca_max: int

    @property
    def order(self) -> int:
        """Number of states."""
        return 2 + self.sc_max + self._memory + 1 + bool(self.coupler.integrator_m_per_n)

    @property
    def _memory(self) -> int:
        return max(len(self.coupler.taps_m_per_n) - 1, self.ca_max)

    def matrix(self, material: Material, sc: int, ca: int) -> Array:
        """Return A (n, n) of the loop in contact with one material at delays sc and ca.

        Args:
            material: K and B.
            sc, ca: n1 and n2 in samples, at most sc_max and ca_max.
        """
        A_device, B_device = self.device.discretise(self.period_s)
        state, first = np.eye(self.order), 2 + self.sc_max  # each state, and what follows of them, as a row over all states
        places, forces = np.vstack([state[:1], state[2:first]]), state[first : first + self._memory]
        before, total, integrator = state[first + self._memory], state[-1], self.coupler.integrator_m_per_n
        taps = np.array(self.coupler.taps_m_per_n)
        past = taps[1:] @ forces[: taps.size - 1] + integrator * total  # the part of C f that older forces make
        direct, rate = taps[0] + integrator - material.spared_m_per_n, material.damping_n_s_per_m / self.period_s
        stiff = material.stiffness_n_per_m + rate
        force = (stiff * (places[sc] - past) - rate * before) / (1.0 + stiff * direct)
        felt = np.vstack([force, forces])[ca]
        avatar = places[sc] - past - direct * force
        after = [*(A_device @ state[:2] - np.outer(B_device, felt)), *places[:-1], *[force, *forces][: self._memory], avatar]
        return np.array([*after, total + force] if integrator else after)

    def radius(self, material: Material, sc: int, ca: int) -> float:
        """Return the spectral radius of `matrix`: below 1 is a stable contact."""
        return float(np.abs(np.linalg.eigvals(self.matrix(material, sc, ca))).max())

    def push_input(self) -> Array:
        """Return B (n, 1): a force of the hand in N, held over a sample."""
        out = np.zeros((self.order, 1))
        out[:2, 0] = self.device.discretise(self.period_s)[1]
        return out

    def jump_system(
        self,
        materials: Sequence[Material],
        material_chain: npt.ArrayLike,
        sc: DelayChain | int,
        ca: DelayChain | int,
    ) -> MJLS:
        """Return the loop as a jump-linear system from the push in N to the position in m.

        The modes are material, label of the S-C chain and label of the C-A chain, all independent.

        Args:
            materials: N of them.
            material_chain: Lambda (N, N), row-stochastic.
            sc, ca: delay chains, or one constant delay in samples.
        """
        chains = [_chain(sc), _chain(ca)]
        lag = [[self.matrix(m, i, j) for i in chains[0][1] for j in chains[1][1]] for m in materials]
        transition = np.kron(np.asarray(material_chain, dtype=np.float64), np.kron(chains[0][0], chains[1][0]))
        depth = np.zeros((1, self.order))
        depth[0, 0] = 1.0
        return MJLS(A=np.array([a for row in lag for a in row]), B=self.push_input(), C=depth, transition=transition)


def _chain(law: DelayChain | int) -> tuple[Array, list[int]]:
    if isinstance(law, int):
        return np.ones((1, 1)), [law]
    return law.matrix, law.delay.tolist()


def push_response(loop: HapticLoop, material: Material, sc: int, ca: int, force_n: float, slots: int) -> Array:
    """Return the position x(0) .. x(slots) in m after a constant push from rest at the surface, in contact throughout.

    Args:
        loop: device, hand, coupler, network.
        material: K and B.
        sc, ca: constant delays in samples.
        force_n: push in N.
        slots: how many samples.
    """
    A, b = loop.matrix(material, sc, ca), loop.push_input()[:, 0] * force_n
    state, out = np.zeros(loop.order), np.zeros(slots + 1)
    for k in range(slots):
        state = A @ state + b
        out[k + 1] = state[0]
    return out
