"""``[controller] kind = "model-following"``: a wall by MJLS-LQG model following, as a comparison with couplers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from design.controllers.virtual_wall import ModelFollowing
from design.controllers.wall import Wall
from design.errors import FieldError
from design.requests.tracking import DesignTask


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
        for name, value in (
            ("force_weight", self.force_weight), ("hand_step_n", self.hand_step_n), ("noise_m", self.noise_m),
        ):  # fmt: skip
            if not (math.isfinite(value) and value > 0.0):
                raise FieldError(name, f"{value!r}, expected a finite number above 0")
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

        from design.passivity.loop import HeldDevice, continuous
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
            self.wall, device, period_s=model.period_s, sc=model.tau_max, ca=model.d_max,
            material_chain=alike if self.material_chain is None else np.array(self.material_chain),
            force_weight=self.force_weight, hand_step_n=self.hand_step_n, noise_m=self.noise_m,
        )  # fmt: skip
