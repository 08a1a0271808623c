"""A hand that holds a haptic device: its own dynamics, its push, and the way that it slides along a wall."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from plants.errors import FieldError
from plants.parts.draws import TURN, Normals, sine
from plants.parts.exponential import exp
from plants.parts.linear import NS_PER_S
from plants.parts.validation import require_finite, require_not_negative, require_positive, require_step

NEVER_NS = 1 << 62
Way = Literal["straight", "lissajous", "wander"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Push:
    """The force that the hand adds by itself, constant over [start, stop), with a seeded tremor.

    The tremor is an Ornstein-Uhlenbeck process, sampled and held: its correlation falls by e in ``tremor_correlation_s``.

    Args:
        force_n: constant part in N, towards the wall where positive.
        start_s, stop_s: when it acts, in s; stop_s None for ever.
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
        require_not_negative("start_s", self.start_s)
        if self.stop_s is not None and not (math.isfinite(self.stop_s) and self.stop_s > self.start_s):
            raise FieldError("stop_s", f"{self.stop_s!r}, expected a finite number above start_s ({self.start_s!r})")
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
            raise FieldError("paces", f"{len(self.paces)}, expected two or more, with way = \"straight\" and without speed_m_s")
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
        mass_kg, damping_n_s_per_m, stiffness_n_per_m: m_h, b_h, k_h, at least 0.
        reach_m: where the hand means to be, in m; behind the surface of the wall where positive.
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


class PushRun:
    """The push over time: what it is now, and when it changes next."""

    __slots__ = (
        "_constant_n", "_decay", "_edge_ns", "_edges", "_hold_ns", "_normals", "_push", "_spread", "_tremor", "force_n",
        "next_ns",
    )  # fmt: skip

    def __init__(self, push: Push, rng: np.random.Generator) -> None:
        stop_ns = NEVER_NS if push.stop_s is None else round(push.stop_s * NS_PER_S)
        self._push, self._normals, self._edges = push, Normals(rng), (round(push.start_s * NS_PER_S), stop_ns)
        self._hold_ns = max(round(push.tremor_hold_s * NS_PER_S), 1)
        self._decay = exp(-push.tremor_hold_s / push.tremor_correlation_s)
        self._spread = push.tremor_n * math.sqrt(1.0 - self._decay * self._decay)
        self._tremor = push.tremor_n * self._normals() if push.tremor_n else 0.0
        self._pass_edges(0)
        self._settle(0)

    def _pass_edges(self, now_ns: int) -> None:
        start_ns, stop_ns = self._edges
        self._constant_n = self._push.force_n if start_ns <= now_ns < stop_ns else 0.0
        self._edge_ns = min((edge for edge in self._edges if edge > now_ns), default=NEVER_NS)

    def _settle(self, now_ns: int) -> None:
        self.force_n, self.next_ns = self._constant_n + self._tremor, self._edge_ns
        if self._push.tremor_n:
            self.next_ns = min(self._edge_ns, now_ns - now_ns % self._hold_ns + self._hold_ns)

    def fire(self) -> None:
        """Let the change that is due happen."""
        now_ns = self.next_ns
        if now_ns >= self._edge_ns:
            self._pass_edges(now_ns)
        if self._push.tremor_n and now_ns % self._hold_ns == 0:
            self._tremor = self._decay * self._tremor + self._spread * self._normals()
        self._settle(now_ns)


def _direction(turns: float) -> tuple[float, float]:
    return sine(turns + 0.25), sine(turns)


class PathRun:
    """The speed of the intended path: constant until it is there, then 0.

    Args:
        hand: where it means to go, and how long that takes.
        now_ns, place_m: when and where it begins.
    """

    __slots__ = ("next_ns", "speed_m_s")

    def __init__(self, hand: Hand, now_ns: int = 0, place_m: float = 0.0) -> None:
        approach_ns, way_m = round(hand.approach_s * NS_PER_S), hand.reach_m - place_m
        self.next_ns = now_ns + approach_ns if way_m else NEVER_NS
        self.speed_m_s = way_m * NS_PER_S / approach_ns if way_m else 0.0

    def fire(self) -> None:
        """Arrive."""
        self.speed_m_s, self.next_ns = 0.0, NEVER_NS


class SlideRun:
    """The place along the wall over time."""

    __slots__ = ("_direction", "_extent", "_pace", "_rng", "_since_ns", "_slide", "_speed_m_s", "_start", "at", "next_ns")

    def __init__(self, slide: Slide, rng: np.random.Generator) -> None:
        self._slide, self._rng, self._since_ns = slide, rng, 0
        self._start = (slide.y_m, slide.z_m)
        self._extent = (0.5 * slide.width_m, 0.5 * slide.height_m, slide.y_hz, slide.z_hz)
        self._direction, self.next_ns = _direction(slide.heading_rad / TURN), NEVER_NS
        self._pace, self._speed_m_s = 0, slide.speed_m_s
        if slide.paces:
            self.next_ns, self._speed_m_s = self._stay_ns(), slide.paces[0].speed_m_s
        if slide.way == "wander":
            self._direction, self.next_ns = self._turned(), round(slide.turn_s * NS_PER_S)
        figures: dict[Way, Callable[[int], tuple[float, float]]] = {
            "straight": self._line, "wander": self._line, "lissajous": self._figure,
        }  # fmt: skip
        self.at = figures[slide.way]  # y and z in m at an instant that is not before the last turn

    def _turned(self) -> tuple[float, float]:
        return _direction(float(self._rng.random()))

    def _stay_ns(self) -> int:
        pace = self._slide.paces[self._pace]
        return max(round((pace.least_s + (pace.most_s - pace.least_s) * float(self._rng.random())) * NS_PER_S), 1)

    def fire(self) -> None:
        """Turn, or go on at another pace."""
        self._start, self._since_ns = self.at(self.next_ns), self.next_ns
        paces = self._slide.paces
        if paces:
            self._pace = (self._pace + 1 + int(float(self._rng.random()) * (len(paces) - 1))) % len(paces)
            self._speed_m_s = paces[self._pace].speed_m_s
            self.next_ns += self._stay_ns()
            return
        self._direction = self._turned()
        self.next_ns += max(round(self._slide.turn_s * NS_PER_S), 1)

    def _line(self, now_ns: int) -> tuple[float, float]:
        way = self._speed_m_s * ((now_ns - self._since_ns) / NS_PER_S)
        return self._start[0] + way * self._direction[0], self._start[1] + way * self._direction[1]

    def _figure(self, now_ns: int) -> tuple[float, float]:
        t_s, (y_m, z_m), (half_y_m, half_z_m, y_hz, z_hz) = now_ns / NS_PER_S, self._start, self._extent
        return y_m + half_y_m * sine(t_s * y_hz), z_m + half_z_m * sine(t_s * z_hz)
