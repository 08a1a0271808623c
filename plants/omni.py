"""The joint of the Phantom Omni haptic device, Chapter 6: bare, or held by a hand that presses on a wall and slides along it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from plants.errors import FieldError, PlantError, require_finite, require_not_negative, require_positive
from plants.parts import Signal, StateSpace
from plants.parts.hand import Hand
from plants.parts.held_run import HeldRun
from plants.parts.linear_run import LinearRun, NoisyRun
from plants.parts.protocols import PassiveElement, PlantRun

_BARE = ((Signal("torque", "N m"),), (Signal("angle", "rad"),), (Signal("angle", "rad"), Signal("speed", "rad/s")))
_HELD = (
    (Signal("force", "N"),),
    (Signal("position", "m"), Signal("y", "m"), Signal("z", "m")),
    tuple(Signal(*s) for s in (("position", "m"), ("speed", "m/s"), ("y", "m"), ("z", "m"), ("push", "N"), ("given", "J"))),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class DampingZone:
    """The damping of the device from a place of its workspace on.

    Args:
        from_m: place of the tip in m.
        damping: b of the joint there, as `Omni.damping`, at least 0.

    Raises:
        FieldError: where a value is out of range.

    Reference: Chapter 6, 6.6: the damping b may change in the workspace.
    """

    from_m: float
    damping: float

    def __post_init__(self) -> None:
        require_finite("from_m", self.from_m)
        require_not_negative("damping", self.damping)


@dataclass(frozen=True, slots=True, kw_only=True)
class Omni:
    """Joint of the haptic device: angle(s) = 1 / (s (m s + b)) torque(s); with a hand, what its tip does at a wall.

    Held by a hand it takes a force in N at the tip and measures the tip's position in m, x = lever angle, and its place y, z
    along the wall: (m/lever^2 + m_h) x'' + (b/lever^2) x' + b_h (x' - p') + k_h (x - p) = force + push.

    The state ``given`` is the passivity observer: the energy in J that the actuator has given beyond what damping takes,
    max(0, sum T (u_k w_k - (b + b_h) w_k^2)), w_k the mean speed over the time that u_k was held. Behind a coupler that meets
    the condition of `design.passivity` it stays 0, so that a limit on it trips before a motion grows.

    Args:
        inertia: m; 0.7943 as identified (printed in kg; in the transfer function it acts as kg m^2).
        damping: b; 1.9857 as identified (printed in N s/m; it acts as N m s/rad), at least 0.
        initial_angle_rad: angle at time 0 in rad.
        initial_speed_rad_s: speed at time 0 in rad/s.
        hand: the hand; without one the joint is bare, and takes a torque and measures an angle.
        lever_m: tip per joint angle in m/rad: 1 reads the printed numbers as kg and N s/m at the tip, 0.135 as a joint.
        force_limit_n: largest magnitude of the force at the tip in N (with a hand); by default no limit.
        encoder_step_m: movement of the tip in m per count; 0 measures the position itself (with a hand).
        coulomb_n: dry friction at the tip in N, for a hand without a spring.
        zones: damping of the device from a place of its tip on, in rising order; before the first it is ``damping`` (with a
            hand). The model, and every proof, has the least.
        encoder_noise_rad: standard deviation of white noise on the measured angle in rad, at least 0 (without a hand).

    Raises:
        ValueError: where a parameter is out of range.

    Reference: thesis (6.1), (6.2), (6.4).

    >>> Omni().model().A.tolist()[1][1] == -1.9857 / 0.7943
    True
    """

    inertia: float = 0.7943
    damping: float = 1.9857
    initial_angle_rad: float = 0.0
    initial_speed_rad_s: float = 0.0
    hand: Hand | None = None
    lever_m: float = 1.0
    force_limit_n: float | None = None
    encoder_step_m: float = 0.0
    coulomb_n: float = 0.0
    zones: tuple[DampingZone, ...] = ()
    encoder_noise_rad: float = 0.0

    def __post_init__(self) -> None:
        require_positive("inertia", self.inertia)
        require_not_negative("damping", self.damping)
        require_finite("initial_angle_rad", self.initial_angle_rad)
        require_finite("initial_speed_rad_s", self.initial_speed_rad_s)
        require_positive("lever_m", self.lever_m)
        require_not_negative("encoder_step_m", self.encoder_step_m)
        require_not_negative("coulomb_n", self.coulomb_n)
        require_not_negative("encoder_noise_rad", self.encoder_noise_rad)
        for i, (before, after) in enumerate(pairwise(self.zones), start=1):
            if not after.from_m > before.from_m:
                said = f"{after.from_m!r}, expected more than {before.from_m!r}, of the one before"
                raise FieldError(f"zones[{i}].from_m", said)
        if self.force_limit_n is not None:
            require_positive("force_limit_n", self.force_limit_n)
        if self.hand is None:
            for name, given in (
                ("lever_m", self.lever_m != 1.0), ("force_limit_n", self.force_limit_n is not None),
                ("encoder_step_m", self.encoder_step_m > 0.0), ("coulomb_n", self.coulomb_n > 0.0),
                ("zones", bool(self.zones)),
            ):  # fmt: skip
                if given:
                    raise FieldError(name, "belongs to the held device; add the table hand")
        elif self.encoder_noise_rad:
            raise FieldError("encoder_noise_rad", "belongs to the bare joint; a held device has encoder_step_m")
        elif self.coulomb_n and (self.hand.stiffness_n_per_m or self.hand.reach_m):
            raise FieldError("coulomb_n", f"{self.coulomb_n!r}; with a spring in the hand the motion through stick and slip has "
                             "no closed form, expected 0")  # fmt: skip

    @property
    def inputs(self) -> tuple[Signal, ...]:
        """What it is driven by."""
        return (_BARE if self.hand is None else _HELD)[0]

    @property
    def outputs(self) -> tuple[Signal, ...]:
        """What it measures."""
        return (_BARE if self.hand is None else _HELD)[1]

    @property
    def states(self) -> tuple[Signal, ...]:
        """What the log keeps of it."""
        return (_BARE if self.hand is None else _HELD)[2]

    @property
    def tracked(self) -> tuple[str, ...]:
        """The output that could follow a reference: how far it is along the wall is the hand's affair."""
        return (self.outputs[0].name,)

    @property
    def tip_mass_kg(self) -> float:
        """Mass at the tip with the hand, in kg."""
        return self.inertia / self.lever_m**2 + (self.hand.mass_kg if self.hand else 0.0)

    @property
    def tip_damping_n_s_per_m(self) -> float:
        """Damping at the tip with the hand, in N s/m; the least where it changes over the workspace."""
        return min(self.tip_dampings_n_s_per_m)

    @property
    def tip_dampings_n_s_per_m(self) -> tuple[float, ...]:
        """Damping at the tip with the hand before the first zone, and in each, in N s/m."""
        hand = self.hand.damping_n_s_per_m if self.hand else 0.0
        return tuple(b / self.lever_m**2 + hand for b in (self.damping, *(zone.damping for zone in self.zones)))

    def model(self) -> StateSpace:
        """Return the continuous-time model: state (angle, speed), held (position, speed) with y and z unmoved by it."""
        if self.hand is None:
            a = [[0.0, 1.0], [0.0, -self.damping / self.inertia]]
            return StateSpace(A=a, B=[[0.0], [1.0 / self.inertia]], C=[[1.0, 0.0]])
        mass = self.tip_mass_kg
        a = [[0.0, 1.0], [-self.hand.stiffness_n_per_m / mass, -self.tip_damping_n_s_per_m / mass]]
        return StateSpace(A=a, B=[[0.0], [1.0 / mass]], C=[[1.0, 0.0], [0.0, 0.0], [0.0, 0.0]])

    def beyond_model(self) -> tuple[str, ...]:
        """Return what acts on the device and is not in `model`; push, path and slide are, as bounded inputs."""
        found = [] if self.force_limit_n is None else [f"a force that saturates at {self.force_limit_n:g} N"]
        found += ["dry friction"] if self.coulomb_n else []
        found += ["damping that changes over the workspace"] if self.zones else []
        found += ["an encoder that rounds"] if self.encoder_step_m else []
        return tuple(found)

    def passive_elements(self) -> tuple[PassiveElement, ...]:
        """Return what of `beyond_model` is passive at the tip: all but an encoder that rounds."""
        names = [name for name in self.beyond_model() if name != "an encoder that rounds"]
        return tuple(PassiveElement(name, self.force_limit_n if "saturates" in name else None) for name in names)

    def own_inputs(self) -> tuple[str, ...]:
        """Return what the hand does of its own will: it pushes, leads the device along its path, and slides along the wall."""
        return () if self.hand is None else ("the hand's push, path and slide",)

    def may_change(self) -> tuple[str, ...]:
        """Return what another device may have that takes over from one that runs: its hand, but for the push and the slide."""
        own = ("mass_kg", "damping_n_s_per_m", "stiffness_n_per_m")
        return () if self.hand is None else (*(f"hand.{name}" for name in own), *self.own_way())

    def own_way(self) -> tuple[str, ...]:
        """Return where the hand leads the device, and how fast."""
        return () if self.hand is None else ("hand.reach_m", "hand.approach_s")

    def go_on(self, run: PlantRun) -> HeldRun:
        """Return this device where another one is, which runs; its hand goes on from where it is.

        Raises:
            PlantError: one of the two is not held.
        """
        if not isinstance(run, HeldRun) or self.hand is None:
            raise PlantError("go_on: a bare joint, expected a device that a hand holds")
        run.change(self, self.hand)
        return run

    def start(self, rng: np.random.Generator) -> LinearRun | NoisyRun | HeldRun:
        """Return the joint at time 0. A bare one without noise draws nothing from ``rng``."""
        if self.hand is None:
            run = LinearRun(self.model(), (self.initial_angle_rad, self.initial_speed_rad_s))
            return NoisyRun(run, self.encoder_noise_rad, rng) if self.encoder_noise_rad else run
        return HeldRun(self, self.hand, rng)
