"""The whole loop in contact as matrices: device and hand, delays, coupler, one material; and as a jump-linear system.

State, M the longer of coupler and force delay:

    (x, v, x(k-1) .. x(k-n1), f(k-1) .. f(k-M), x_v(k-1), q)

The controller has x(k - n1) in slot k, the device feels f(k - n2). In contact f = K x_v + B (x_v(k) - x_v(k-1))/T and
x_v = x(k - n1) - (C f)(k), both solved for f(k); q is the state of the coupler's integrator.

Reference: Chapter 6, Figure 6.4; delays in the state.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.controllers.coupler import Coupler
from design.controllers.wall import Material
from design.jump_linear.mjls import MJLS
from design.passivity.device import HeldDevice
from design.processes.delay_chain import DelayChain

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class HapticLoop:
    """A held device that presses on a wall through a coupler and a network.

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
        n, memory, first = self.order, self._memory, 2 + self.sc_max
        before, integrator = first + memory, self.coupler.integrator_m_per_n
        seen = np.zeros(n)
        seen[0 if sc == 0 else 1 + sc] = 1.0
        past = np.zeros(n)  # the part of C f that older forces make
        taps = self.coupler.taps_m_per_n
        past[first : first + len(taps) - 1] = taps[1:]
        direct = taps[0] + integrator
        if integrator:
            past[before + 1] = integrator
        rate = material.damping_n_s_per_m / self.period_s
        stiff = material.stiffness_n_per_m + rate
        force = stiff * (seen - past)
        force[before] -= rate
        force /= 1.0 + stiff * direct
        avatar = seen - past - direct * force
        A = np.zeros((n, n))
        A[:2, :2] = A_device
        if ca == 0:
            A[:2] -= np.outer(B_device, force)
        else:
            A[:2, first + ca - 1] -= B_device
        for i in range(self.sc_max):
            A[2 + i, 0 if i == 0 else 1 + i] = 1.0
        if memory:
            A[first] = force
            for i in range(1, memory):
                A[first + i, first + i - 1] = 1.0
        A[before] = avatar
        if integrator:
            A[before + 1] = force
            A[before + 1, before + 1] += 1.0
        return A

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
