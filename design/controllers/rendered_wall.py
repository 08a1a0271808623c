"""What renders a wall in the loop: the coupler, and what a controller states of itself to the certifiers and pages of its loop.

A loop without a wall imports no wall.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from msgspec import Struct
from numpy.typing import NDArray

from design.controllers.contract import LoopModel, RunningController, Selection
from design.errors import FieldError, check_at_least_zero, check_finite

if TYPE_CHECKING:
    from design.controllers.wall import Wall


MAX_TAPS = 512


class Coupler(Struct, frozen=True, kw_only=True):
    """A coupler with a finite impulse response and, if d is not 0, an integrator.

    It says how far the avatar stays behind the device while the wall pushes back.

    The avatar stands at x_v(k) = x(k) - (C f)(k), where f is the force of the wall on it and

        C(z) = c_0 + c_1 z^-1 + ... + c_L z^-L + d z/(z - 1).

    Reference: Chapter 6, Figure 6.4 and the form of C_i(z) before (6.13).

    Args:
        taps_m_per_n: c_0, c_1, ... in m/N, 1 to 512 of them.
        integrator_m_per_n: d in m/N per sample, at least 0. A static force makes the avatar creep for ever unless it is 0.

    Raises:
        FieldError: no tap, too many, or a number that is not finite or d below 0.
    """

    taps_m_per_n: tuple[float, ...]
    integrator_m_per_n: float = 0.0

    def __post_init__(self) -> None:
        if not 1 <= len(self.taps_m_per_n) <= MAX_TAPS:
            raise FieldError("taps_m_per_n", f"{len(self.taps_m_per_n)} taps, expected 1 to {MAX_TAPS}")
        check_finite(**{f"taps_m_per_n[{l}]": tap for l, tap in enumerate(self.taps_m_per_n)})
        check_at_least_zero(integrator_m_per_n=self.integrator_m_per_n)

    @property
    def static_compliance_m_per_n(self) -> float:
        """C(1) in m/N: how far a constant newton moves the device beyond the wall's own depth; inf with an integrator."""
        return math.inf if self.integrator_m_per_n else math.fsum(self.taps_m_per_n)


def wave_coupler(period_s: float, damping_n_s_per_m: float, delay: int) -> Coupler:
    """Return the coupler that meets the condition for one delay with equality, C(z) = T/(2 b) (1 + z^-1 + ... + z^-nd).

    Its static stiffness is the ceiling 2 b/((nd + 1) T). It has no margin: one sample of delay more breaks the condition.

    Args:
        period_s: T in s.
        damping_n_s_per_m: b, damping of the device and least damping of the hand, N s/m, above 0.
        delay: nd, samples from measurement to force, at least 0.
    """
    tap = math.nextafter(period_s / (2.0 * damping_n_s_per_m), math.inf)  # rounded up: never below the condition
    return Coupler(taps_m_per_n=(tap,) * (delay + 1))


def static_coupler(compliance_m_per_n: float) -> Coupler:
    """Return C(z) = compliance, in m/N; with T/(2 b) it is the coupler of Theorem 6.1 in its simplest form."""
    return Coupler(taps_m_per_n=(compliance_m_per_n,))


Array = NDArray[np.float64]
Matrix = tuple[tuple[float, ...], ...]


@runtime_checkable
class RendersWall(Protocol):
    """A controller that renders a wall, or asks for one that does."""

    wall: Wall


@runtime_checkable
class WallController(Protocol):
    """A controller that renders a wall through a coupler; over a device with a hand its loop can be certified passive."""

    wall: Wall
    coupler: Coupler
    equalise: bool
    """Whether both ends wait until the largest delay has passed."""

    def start(self, model: LoopModel) -> RunningController: ...


@runtime_checkable
class ModelFollower(Protocol):
    """A controller that renders a wall by following a model; in contact it is linear, one map per material."""

    wall: Wall
    feedback: Matrix

    def start(self, model: LoopModel) -> LinearInContact: ...


@runtime_checkable
class LinearInContact(Protocol):
    """A running controller that is linear while the device is in contact."""

    selection: Selection

    @property
    def order(self) -> int:
        """Number of its states."""

    def linear(self, state: Array, place: float, material: int) -> tuple[float, Array]:
        """Return the force and the next state, for a state, the delayed place, and a material."""
