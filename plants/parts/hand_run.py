"""The hand while it runs: its push, its intended path, and its place along the wall."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from plants.parts.draws import TURN, Normals, sine
from plants.parts.exponential import exp
from plants.parts.hand import NEVER_NS, Hand, Push, Slide, Way
from plants.parts.linear import NS_PER_S


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
