"""Walls that an experiment asks for: ``kind = "virtual-wall"`` renders by a coupler, ``"model-following"`` by MJLS-LQG.

What runs is the taps or the gains that come out. Model following is a comparison with couplers.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

from design.controllers.rendered_wall import Coupler, wave_coupler
from design.controllers.virtual_wall import ModelFollowing, VirtualWall
from design.controllers.wall import Wall
from design.errors import FieldError, check_above_zero
from design.requests.tracking import DesignTask

Method = Literal["stiffest", "wave", "theorem-6.1", "taps"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CouplerRequest:
    """Which coupler is wanted.

    Args:
        method: ``stiffest``, the least static compliance that is safe for every passive hand at every delay of the set; ``wave``,
            the closed form for the largest delay alone; ``theorem-6.1``, the printed T/(2 b), which knows no delay; or ``taps``.
        delays: total delays in samples that the coupler is to be safe for; by default those that the loop can have.
        damping_n_s_per_m: damping of device and hand in N s/m that the coupler counts on; by default the model's.
        stiffness_n_per_m: a static stiffness in N/m that is to be reached (``stiffest``); refused above the ceiling.
        count: number of taps (``stiffest``); 0 for as many as the delays call for.
        taps_m_per_n: the taps themselves in m/N (``taps``).
        integrator_m_per_n: gain of an integrator beside them in m/N per sample (``taps``).
        equalise: whether both ends wait until the largest delay has passed, so that a delay that varies becomes one that stays.
        varying: whether it is to be safe while the delay varies from sample to sample (``stiffest``), instead of waiting.
        per_material: whether every material spares the coupler what it gives itself, C_i(z) = C(z) - s_i (`sparing`).

    Raises:
        FieldError: where a value is out of range.
    """

    method: Method = "stiffest"
    delays: tuple[int, ...] = ()
    damping_n_s_per_m: float | None = None
    stiffness_n_per_m: float | None = None
    count: int = 0
    taps_m_per_n: tuple[float, ...] = ()
    integrator_m_per_n: float = 0.0
    equalise: bool = False
    per_material: bool = False
    varying: bool = False

    def __post_init__(self) -> None:
        if self.method not in get_args(Method):
            raise FieldError("method", f"{self.method!r}, expected one of {', '.join(get_args(Method))}")
        for i, delay in enumerate(self.delays):
            if delay < 0:
                raise FieldError(f"delays[{i}]", f"{delay}, expected at least 0")
        check_above_zero(damping_n_s_per_m=self.damping_n_s_per_m, stiffness_n_per_m=self.stiffness_n_per_m)
        if self.count < 0:
            raise FieldError("count", f"{self.count}, expected at least 1, or 0")
        if self.varying and (self.method != "stiffest" or self.equalise or self.delays):
            raise FieldError("varying", 'belongs to method = "stiffest" without equalise; its delays are those of the network')
        if self.per_material and self.method == "taps":
            raise FieldError("per_material", "given taps run as they are; give wall.materials[i].spared_m_per_n")
        if bool(self.taps_m_per_n) != (self.method == "taps"):
            raise FieldError("taps_m_per_n", 'give them with method = "taps", and with no other')


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignedWall:
    """A virtual wall, felt through a coupler that is made when the experiment is composed (Chapter 6).

    Args:
        wall: materials, where they lie, what happens where they change.
        coupler: which coupler.
    """

    wall: Wall = field(default_factory=Wall)
    coupler: CouplerRequest = field(default_factory=CouplerRequest)

    @property
    def gains_given(self) -> bool:
        """Whether nothing is solved: the experiment has the taps."""
        return self.coupler.method == "taps"

    def solve(self, task: DesignTask) -> VirtualWall:
        """Return the wall with the taps that run.

        Raises:
            FieldError: a plant that is no device at a wall.
            DesignError: the stiffness asked for cannot be reached; the message has the number that decides it.
        """
        model, asked = task.model, self.coupler
        largest = model.tau_max + model.d_max
        sides = [{limit} if chain is None else {int(d) for d in chain.delay} for chain, limit in
                 ((task.sc, model.tau_max), (task.ca, model.d_max))]  # fmt: skip
        spread = model.tau_max if task.sc is None else model.tau_max - min(sides[0])
        delays = asked.delays or tuple(sorted({i + j for i in sides[0] for j in sides[1]}))
        if asked.equalise and not asked.delays:
            delays = (largest,)
        if asked.varying:
            from design.passivity.certificate import lags

            delays = lags(*sides)
        beta = asked.damping_n_s_per_m
        if beta is None:
            check_device(task)
            beta = 0.0 if asked.method == "taps" else damping_of(task)  # given taps count on none
        makers: dict[Method, Callable[[], Coupler]] = {
            "stiffest": lambda: self._stiffest(delays, model.period_s, beta),
            "wave": lambda: wave_coupler(model.period_s, beta, max(delays)),
            "theorem-6.1": lambda: wave_coupler(model.period_s, beta, 0),
            "taps": lambda: Coupler(taps_m_per_n=asked.taps_m_per_n, integrator_m_per_n=asked.integrator_m_per_n),
        }
        if not (asked.method == "taps" or beta > 0.0):
            raise FieldError("coupler.damping_n_s_per_m", f"{beta + 0.0:g}; without damping no coupler is safe for every hand")
        samples = 1 + spread if asked.equalise else 1
        coupler = makers[asked.method]()
        return VirtualWall(wall=self._sparing(coupler, model.period_s), coupler=coupler, equalise=asked.equalise, samples=samples)

    def _sparing(self, coupler: Coupler, period_s: float) -> Wall:
        if not self.coupler.per_material:
            return self.wall
        from design.passivity.transparency import sparing

        return replace(self.wall, materials=sparing(self.wall.materials, coupler, period_s))

    def _stiffest(self, delays: tuple[int, ...], period_s: float, beta: float) -> Coupler:
        from design.passivity.synthesis import stiffest_coupler

        return stiffest_coupler(
            delays, period_s=period_s, damping_n_s_per_m=beta, taps=self.coupler.count or None, varying=self.coupler.varying,
            stiffness_n_per_m=self.coupler.stiffness_n_per_m,
        ).coupler  # fmt: skip


def check_device(task: DesignTask) -> None:
    """Refuse a plant that is no device.

    Args:
        task: a plant of state (position, speed) under one force.

    Raises:
        FieldError: another kind of plant.
    """
    if task.model.A.shape != (2, 2) or task.model.B.shape != (2, 1):
        raise FieldError("wall", "needs a device with a position, a speed and one force, such as an omni with a hand")


def damping_of(task: DesignTask) -> float:
    """Return the damping b + b_h in N s/m of the device in a model: what its speed loses, by the matrix logarithm.

    Args:
        task: a plant of state (position, speed) under one force.

    Raises:
        FieldError: its damping cannot be said.
    """
    from design.passivity import continuous

    model = task.model
    rates = continuous(model.A, model.B, model.period_s)
    # an ulp less than it may be: taps made for less damping hold for more
    return float(-rates[1, 1] / rates[1, 2]) * (1.0 - 1e-9)


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignedFollowing:
    """A wall that the device is made to follow by feedback, designed for the one hand of the plant (Chapter 6, (6.7)).

    Args:
        wall: materials, and where they lie; the force limit and the switching rule are of no use to it.
        material_chain: nested tuple [i][j], Lambda over all materials; by default every material follows every other alike, or
            the one that is touched stays.
        force_weight: r, weight of a force beside that of the target in m^2/N^2, above 0.
        hand_step_n: how much the hand's force changes in a sample, standard deviation in N, above 0.
        noise_m: noise of the position, standard deviation in m, above 0.

    Raises:
        FieldError: where a value is out of range.
    """

    wall: Wall = field(default_factory=Wall)
    material_chain: tuple[tuple[float, ...], ...] | None = None
    force_weight: float = 1e-7
    hand_step_n: float = 0.05
    noise_m: float = 1e-5

    def __post_init__(self) -> None:
        check_above_zero(force_weight=self.force_weight, hand_step_n=self.hand_step_n, noise_m=self.noise_m)
        if self.wall.chain is not None:
            raise FieldError("wall.chain", "the target depends on where the hand is; give a pattern or one material")
        count = len(self.wall.materials)
        for i, row in enumerate(self.material_chain or ()):
            if len(row) != count or len(self.material_chain or ()) != count or min(row) < 0.0 or abs(sum(row) - 1.0) > 1e-9:
                raise FieldError(f"material_chain[{i}]", f"{row}, expected {count} rows of {count} shares that sum to 1")

    def solve(self, task: DesignTask) -> ModelFollowing:
        """Return the gains that run.

        Raises:
            FieldError: a plant that is no device at a wall.
            DesignError: the coupled Riccati equations do not converge.
        """
        import numpy as np

        from design.passivity import HeldDevice, continuous
        from design.passivity.model_following import follow_wall

        model, count = task.model, len(self.wall.materials)
        if model.A.shape != (2, 2) or model.B.shape != (2, 1) or model.C.shape[0] != 3:
            raise FieldError("wall", "needs a device with a position, a speed and one force that measures position, y and z")
        rates = continuous(model.A, model.B, model.period_s)
        mass = 1.0 / float(rates[1, 2])
        device = HeldDevice(
            mass_kg=mass, damping_n_s_per_m=max(-float(rates[1, 1]) * mass, 0.0),
            hand_stiffness_n_per_m=max(-float(rates[1, 0]) * mass, 0.0),
        )  # fmt: skip
        alike = np.eye(count) if self.wall.pattern is None else np.full((count, count), 1.0 / count)
        return follow_wall(
            self.wall, device, period_s=model.period_s, sc=model.tau_max if task.sc is None else task.sc.max_delay,
            ca=model.d_max if task.ca is None else task.ca.max_delay,
            material_chain=alike if self.material_chain is None else np.array(self.material_chain),
            force_weight=self.force_weight, hand_step_n=self.hand_step_n, noise_m=self.noise_m,
        )  # fmt: skip
