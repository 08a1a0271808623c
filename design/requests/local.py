"""A controller of a plant without a network, by python-control: what a networked design is compared with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from design.controllers import LoopModel, OutputFeedback
from design.requests.task import DesignTask

if TYPE_CHECKING:
    from design.controllers import LinearLaw


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalDesigned:
    """LQR, LQG or H-infinity for the plant alone; it ignores the network that it runs over, and is judged over it.

    Args:
        method: ``lqr``, ``lqg`` or ``hinf``, see `design.local.python_control`.
        input_weight: rho of z = [C x; rho u], output units per input unit.
        noise: standard deviation of a sample per unit of the input disturbance's (``lqg`` and ``hinf``).
    """

    method: Literal["lqr", "lqg", "hinf"] = "lqg"
    input_weight: float = 0.01
    noise: float = 0.01

    def law(self, model: LoopModel) -> LinearLaw:
        """Return the controller's matrices.

        Args:
            model: the plant at the sample period.

        Raises:
            FieldError: names the field.
            DesignError: a Riccati equation has no stabilising solution.
        """
        from design.local.python_control import local_design

        return local_design(model.A, model.B, model.C, self.method, input_weight=self.input_weight, noise=self.noise)

    def solve(self, task: DesignTask) -> OutputFeedback:
        """Return the controller that runs.

        Args:
            task: the loop; its network is not looked at.
        """
        law = self.law(task.model)
        A, B, C, D = (tuple(tuple(map(float, row)) for row in M) for M in (law.A, law.B, law.C, law.D))
        return OutputFeedback(A=A, B=B, C=C, D=D)
