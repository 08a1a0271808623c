"""A weight W of a user's own: at which frequencies a coupler is to be stiff.

Reference: Chapter 6, (6.12), (6.13).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.controllers.rendered_wall import Coupler
from design.errors import FieldError


@dataclass(frozen=True, slots=True)
class Weight:
    """W(z) = (b_0 + b_1 z^-1 + ...)/(a_0 + a_1 z^-1 + ...), stable.

    Raises:
        FieldError: no coefficient, one that is not finite, a zero first one below, or a pole on or outside the circle.
    """

    numerator: tuple[float, ...]
    denominator: tuple[float, ...] = (1.0,)

    def __post_init__(self) -> None:
        for name, given in (("numerator", self.numerator), ("denominator", self.denominator)):
            if not given or not np.isfinite(given).all() or not any(given):
                raise FieldError(name, f"{list(given)}, expected finite coefficients of z^0, z^-1, ..., not all zero")
        poles = np.abs(np.roots(self.denominator)) if self.denominator[0] else np.array([np.inf])
        if poles.size and poles.max() >= 1.0:
            raise FieldError("denominator", f"{list(self.denominator)} has a pole of modulus {poles.max():.6g}, expected below 1")

    def at(self, t: npt.NDArray[np.float64]) -> npt.NDArray[np.complex128]:
        """Return W(e^it).

        Args:
            t: angles in rad per sample.
        """
        z = np.exp(-1j * t)
        over, under = (np.polyval(c[::-1], z) for c in (self.numerator, self.denominator))
        return np.asarray(over / under, dtype=np.complex128)

    def of_taps(self, count: int, t: npt.NDArray[np.float64]) -> npt.NDArray[np.complex128]:
        """Return W(e^it) e^-ilt for l = 0 .. count - 1 as rows: what each tap adds to W C.

        Args:
            count: number of taps.
            t: angles in rad per sample.
        """
        return np.asarray(self.at(t) * np.exp(-1j * np.outer(np.arange(count), t)))

    def peak(self, coupler: Coupler) -> float:
        """Return the largest |W(z) C(z)| on the circle, in m/N.

        Args:
            coupler: C, without an integrator.
        """
        t = np.linspace(0.0, np.pi, 256 * len(coupler.taps_m_per_n) + 1)
        return float(np.abs(self.at(t) * np.polyval(coupler.taps_m_per_n[::-1], np.exp(-1j * t))).max())
