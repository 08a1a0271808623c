"""The joint of the Phantom Omni held by a hand, while it runs: one step of a slot at a time."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from plants.errors import PlantError
from plants.parts import NEVER_NS, NS_PER_S
from plants.parts.actuators import Encoder, Friction
from plants.parts.draws import TURN, Normals, sine
from plants.parts.exponential import exp
from plants.parts.flow import Flow, Source, pass_time
from plants.parts.hand import Hand, Push, Slide, Way
from plants.parts.rubbing_axis import RubbingAxis

if TYPE_CHECKING:
    from plants.omni import DampingZone, Omni

LOOK_NS: Final = 1_000_000
"""How long the damping is that of the place where the tip was."""


class HeldRun:
    """The held device while it runs. See `Omni` for the equations."""

    __slots__ = (
        "_applied", "_damping", "_dry", "_flow", "_force", "_given", "_limit", "_now_ns", "_path", "_place", "_push", "_read",
        "_slide", "_sources", "_ways", "_x", "_zones",
    )  # fmt: skip

    def __init__(self, omni: Omni, hand: Hand, rng: np.random.Generator) -> None:
        self._push, self._slide = PushRun(hand.push, rng), SlideRun(hand.slide, rng)
        self._zones = ZoneRun(omni.zones)
        self._x = [omni.lever_m * omni.initial_angle_rad, omni.lever_m * omni.initial_speed_rad_s, 0.0]
        self._move_as(omni, hand, PathRun(hand))
        self._place = self._slide.at(0)
        self._limit = math.inf if omni.force_limit_n is None else omni.force_limit_n
        self._read = Encoder(step_rad=omni.encoder_step_m).read
        self._now_ns, self._force, self._applied, self._given = 0, 0.0, (0.0,), 0.0

    def _move_as(self, omni: Omni, hand: Hand, path: PathRun) -> None:
        mass, spring = omni.tip_mass_kg, hand.stiffness_n_per_m
        self._ways = []
        for beta in omni.tip_dampings_n_s_per_m:
            # (x, v, p) under (force + push, p')
            drawn = [[0.0, 1.0, 0.0], [-spring / mass, -beta / mass, spring / mass], [0.0, 0.0, 0.0]]
            flow = Flow(drawn, [[0.0, 0.0], [1.0 / mass, hand.damping_n_s_per_m / mass], [0.0, 1.0]])
            dry = RubbingAxis(1.0 / mass, beta / mass, Friction(coulomb_v=omni.coulomb_n)) if omni.coulomb_n else None
            self._ways.append((flow, dry))
        self._flow, self._dry = self._ways[self._zones.at(self._x[0])]
        self._damping, self._path = omni.tip_damping_n_s_per_m, path
        self._sources: tuple[Source, ...] = (self._push, path, self._slide, *self._zones.sources)

    def change(self, omni: Omni, hand: Hand) -> None:
        """Go on with other parameters; the hand leads it from where it is."""
        self._move_as(omni, hand, PathRun(hand, self._now_ns, self._x[2]))

    def advance(self, dt_ns: int, u: Sequence[float], w: Sequence[float] = ()) -> None:
        """Hold the command for dt_ns.

        Args:
            dt_ns: time in nanoseconds, at least 0.
            u: commanded force in N, one entry.
            w: disturbance in N at the tip, one entry or nothing.
        """
        if dt_ns < 0:
            raise PlantError(f"advance: {dt_ns} ns, expected a time that does not run backwards")
        force, limit, slide = u[0], self._limit, self._slide
        force = limit if force > limit else -limit if force < -limit else force
        self._applied = (force,)
        self._force = force + w[0] if w else force
        before, now_ns = self._x[0], self._now_ns
        end_ns = now_ns + dt_ns
        pass_time(now_ns, end_ns, self._sources, self._move)
        self._now_ns = end_ns
        if dt_ns:
            self._place = slide.at(end_ns)
            moved = self._x[0] - before
            self._given += moved * (force - self._damping * moved * NS_PER_S / dt_ns)

    def _move(self, begin_ns: int, end_ns: int) -> None:
        if self._zones.looks:
            self._zones.looks = False
            self._flow, self._dry = self._ways[self._zones.at(self._x[0])]
        force = self._force + self._push.force_n
        if self._dry is not None:
            position, speed = self._dry.hold(self._x[0], self._x[1], force, end_ns - begin_ns)
            self._x = [position, speed, 0.0]
        else:
            self._x = self._flow.step(self._x, (force, self._path.speed_m_s), end_ns - begin_ns)

    def measure(self) -> tuple[float, ...]:
        """Return the position in m as the encoder gives it, and the place y, z along the wall in m."""
        return (self._read(self._x[0]), *self._place)

    @property
    def state(self) -> tuple[float, ...]:
        """Position in m, speed in m/s, y and z in m, push in N, energy given in J: the true ones."""
        x, given = self._x, self._given
        return (x[0], x[1], *self._place, self._push.force_n, given if given > 0.0 else max(given, 0.0))

    @property
    def applied(self) -> tuple[float, ...]:
        """Force in N that the actuator put out in the last advance, without the disturbance."""
        return self._applied


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


class ZoneRun:
    """When the zone is looked up again; on whole milliseconds, so that cutting an advance in two changes nothing.

    Args:
        zones: in rising order; none: it is never looked up.
    """

    __slots__ = ("_from_m", "looks", "next_ns")

    def __init__(self, zones: Sequence[DampingZone]) -> None:
        self._from_m = [zone.from_m for zone in zones]
        self.looks = False
        self.next_ns = LOOK_NS if zones else NEVER_NS

    @property
    def sources(self) -> tuple[ZoneRun, ...]:
        """Itself, as a source of events; nothing without zones."""
        return (self,) if self._from_m else ()

    def at(self, place_m: float) -> int:
        """Return which zone a place is in: 0 before the first.

        Args:
            place_m: of the tip.
        """
        return bisect_right(self._from_m, place_m)

    def fire(self) -> None:
        """Have it looked up before the next movement."""
        self.looks = True
        self.next_ns += LOOK_NS
