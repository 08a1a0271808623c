"""A haptic device held by a hand, as a mass, a damper and a spring; and what moves it in one sample.

    (m + m_h) x'' + (b + b_h) x' + k_h x = u + push,     u held over a sample

Reference: Chapter 6, (6.1), (6.2), (6.4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm, logm

from design.errors import FieldError

Array = npt.NDArray[np.float64]

LEAST_LEFT: Final = 1e-12
"""Of a speed at the end of a sample: of less, a model in double precision has too few digits to tell how it was lost."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldDevice:
    """A device and the hand that holds it rigidly.

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
        if not (math.isfinite(self.mass_kg) and self.mass_kg > 0.0):
            raise FieldError("mass_kg", f"{self.mass_kg!r}, expected a finite number above 0")
        for name, value in (
            ("damping_n_s_per_m", self.damping_n_s_per_m),
            ("hand_mass_kg", self.hand_mass_kg),
            ("hand_damping_n_s_per_m", self.hand_damping_n_s_per_m),
            ("hand_stiffness_n_per_m", self.hand_stiffness_n_per_m),
        ):
            if not (math.isfinite(value) and value >= 0.0):
                raise FieldError(name, f"{value!r}, expected a finite number, at least 0")

    @property
    def total_damping_n_s_per_m(self) -> float:
        """b + b_h in N s/m: what the condition for the coupler may count on."""
        return self.damping_n_s_per_m + self.hand_damping_n_s_per_m

    def discretise(self, period_s: float) -> tuple[Array, Array]:
        """Return A (2, 2) and B (2,) of the state (position, speed), the force held over T.

        Args:
            period_s: T in s.
        """
        mass = self.mass_kg + self.hand_mass_kg
        field = np.zeros((3, 3))
        field[0, 1] = 1.0
        field[1] = np.array([-self.hand_stiffness_n_per_m, -self.total_damping_n_s_per_m, 1.0]) / mass
        held = expm(field * period_s)
        return held[:2, :2], held[:2, 2]


def continuous(A: Array, B: Array, period_s: float) -> Array:
    """Return the equations of a device whose force is held: (x, v, f)' = M (x, v, f), by the matrix logarithm.

    Args:
        A, B: of one sample, shapes (2, 2) and (2, 1), for the state (position, speed).
        period_s: sample period in s.

    Returns:
        M in 1/s, shape (3, 3).

    Raises:
        FieldError: the speed is gone within a sample, so that its damping cannot be told.
    """
    if not np.linalg.det(A) > LEAST_LEFT:
        raise FieldError("plant", f"its speed is gone within a sample of {period_s:g} s, so that its damping cannot be told")
    return np.asarray(np.real(logm(np.block([[A, B], [np.zeros((1, 2)), np.ones((1, 1))]]))) / period_s)
