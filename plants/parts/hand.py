"""A hand that holds a haptic device: its own dynamics, its push, and the way that it slides along a wall."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal, get_args

from plants.errors import FieldError, require_finite, require_not_negative, require_positive, require_step, require_time_span

Way = Literal["straight", "lissajous", "wander"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Push:
    """The force that the hand adds by itself, constant over [start, stop), with a seeded tremor.

    The tremor is an Ornstein-Uhlenbeck process, sampled and held: its correlation falls by e in ``tremor_correlation_s``.

    Args:
        force_n: constant part in N, towards the wall where positive.
        start_s, stop_s: when it acts, in s; by default for ever.
        tremor_n: standard deviation of the tremor in N, all the time; 0 for none.
        tremor_correlation_s: its correlation time in s.
        tremor_hold_s: how long a sample of it is held, in s.

    Raises:
        FieldError: where a value is out of range.
    """

    force_n: float = 0.0
    start_s: float = 0.0
    stop_s: float | None = None
    tremor_n: float = 0.0
    tremor_correlation_s: float = 0.3
    tremor_hold_s: float = 0.001

    def __post_init__(self) -> None:
        require_finite("force_n", self.force_n)
        require_time_span(self.start_s, self.stop_s)
        require_not_negative("tremor_n", self.tremor_n)
        require_positive("tremor_correlation_s", self.tremor_correlation_s)
        require_step("tremor_hold_s", self.tremor_hold_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """A speed of the hand along the wall, and how long it lasts: uniformly between two times, so that speed is semi-Markov.

    Args:
        speed_m_s: speed in m/s, at least 0.
        least_s, most_s: shortest and longest stay at this speed in s, above 0.

    Raises:
        FieldError: where a value is out of range.

    Reference: Chapter 6, 6.6: a sliding speed that varies as a semi-Markov process.
    """

    speed_m_s: float
    least_s: float
    most_s: float

    def __post_init__(self) -> None:
        require_not_negative("speed_m_s", self.speed_m_s)
        require_step("least_s", self.least_s)
        if not (math.isfinite(self.most_s) and self.most_s >= self.least_s):
            raise FieldError("most_s", f"{self.most_s!r}, expected a finite number, at least least_s ({self.least_s!r})")


@dataclass(frozen=True, slots=True, kw_only=True)
class Slide:
    """The way of the hand along the wall, in the plane of y and z.

    ``straight`` keeps its heading; ``lissajous`` is y = width/2 sin(2 pi f_y t), z = height/2 sin(2 pi f_z t) around the start;
    ``wander`` keeps its speed and takes a new, uniformly random heading every ``turn_s``.

    Args:
        way: which of them.
        y_m, z_m: start in m.
        speed_m_s: speed in m/s (not of a Lissajous figure).
        heading_rad: direction from the y axis towards the z axis in rad (``straight``).
        width_m, height_m: extent of a Lissajous figure in m.
        y_hz, z_hz: its frequencies along y and z in Hz.
        turn_s: time between two turns in s (``wander``).
        paces: speeds that follow each other at random, the first one first, each other one as likely as the rest (``straight``);
            they stand for ``speed_m_s``.

    Raises:
        FieldError: where a value is out of range.
    """

    way: Way = "straight"
    y_m: float = 0.0
    z_m: float = 0.0
    speed_m_s: float = 0.0
    heading_rad: float = 0.0
    width_m: float = 0.1
    height_m: float = 0.1
    y_hz: float = 0.2
    z_hz: float = 0.3
    turn_s: float = 0.05
    paces: tuple[Pace, ...] = ()

    def __post_init__(self) -> None:
        if self.paces and (len(self.paces) < 2 or self.way != "straight" or self.speed_m_s):
            raise FieldError("paces", f'{len(self.paces)}, expected two or more, with way = "straight" and without speed_m_s')
        if self.way not in get_args(Way):
            raise FieldError("way", f"{self.way!r}, expected one of {', '.join(get_args(Way))}")
        for name, value in (("y_m", self.y_m), ("z_m", self.z_m), ("heading_rad", self.heading_rad)):
            require_finite(name, value)
        for name, value in (("speed_m_s", self.speed_m_s), ("width_m", self.width_m), ("height_m", self.height_m)):
            require_not_negative(name, value)
        require_not_negative("y_hz", self.y_hz)
        require_not_negative("z_hz", self.z_hz)
        require_step("turn_s", self.turn_s)


@dataclass(frozen=True, slots=True, kw_only=True)
class Hand:
    """A hand, rigidly at the device: m_h x'' + b_h (x' - p') + k_h (x - p) is what it asks of the device, minus its push.

    p(t) is the intended path: from 0 to ``reach_m`` at constant speed during the first ``approach_s``.

    Args:
        mass_kg, damping_n_s_per_m, stiffness_n_per_m: its mass m_h in kg, damping b_h in N s/m, spring k_h in N/m; at least 0.
        reach_m: where the hand wants to be, in m; behind the surface of the wall where positive.
        approach_s: how long it takes to go there in s, above 0.
        push: force that it adds.
        slide: its way along the wall.

    Raises:
        FieldError: where a value is out of range.

    Reference: Chapter 6, H(s) of Theorem 6.1.
    """

    mass_kg: float = 0.0
    damping_n_s_per_m: float = 0.0
    stiffness_n_per_m: float = 0.0
    reach_m: float = 0.0
    approach_s: float = 1.0
    push: Push = field(default_factory=Push)
    slide: Slide = field(default_factory=Slide)

    def __post_init__(self) -> None:
        require_not_negative("mass_kg", self.mass_kg)
        require_not_negative("damping_n_s_per_m", self.damping_n_s_per_m)
        require_not_negative("stiffness_n_per_m", self.stiffness_n_per_m)
        require_finite("reach_m", self.reach_m)
        require_step("approach_s", self.approach_s)
