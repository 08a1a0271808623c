"""What is needed to run an experiment: composed once, received by every process of the run; and the digest of what is judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from msgspec import Struct
from msgspec.structs import replace

from design.controllers import Controller, LoopModel, MultiSampleController, RunningController
from design.verdict import Verdict, digest
from hil.errors import ForeignVerdict
from hil.experiment import Experiment
from hil.rig.delay_chains import Chains
from hil.rig.piecewise import Piecewise
from hil.rig.spec import RigSpec
from hil.rig.watched import Watched

Origin = Literal["stored", "solved here"]


class Gains(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Where the gains of a run come from.

    Args:
        origin: ``stored``, from a file beside the experiment: the same on every machine; or ``solved here``.
        note: why they were solved here, and what helps; nothing where they were stored.
    """

    origin: Origin
    note: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """What is needed to run: plain data, cheap to pickle.

    Args:
        experiment: the checked description.
        model: what the controller knows of the plant, and the bounds of both delays.
        controller: controller parameters, with any design already solved.
        rig: what the experiment says of its rig, laws tabulated: no process that keeps time computes their distributions.
        chains: the delay chains of its network, with the labels that the controller distinguishes.
        rows: rows in one send-all packet.
        selection: how the actuator picks one of them.
        samples: samples that the controller takes from a node: the newest, and so many less one before it.
        verdict: what is claimed of the closed loop, None if not asked for.
        gains: where solved gains come from; None where the experiment itself has them.
        watched: what the run is compared with; None where no claim rests on it.
    """

    experiment: Experiment
    model: LoopModel
    controller: Controller
    rig: RigSpec
    chains: Chains
    rows: int
    selection: str
    samples: int
    verdict: Verdict | None
    gains: Gains | None = None
    watched: Watched | None = None

    def __post_init__(self) -> None:
        if self.verdict is not None and self.verdict.digest != digest_of(self.experiment, self.controller, self.model):
            raise ForeignVerdict(f"verdict: it is on system {self.verdict.digest[:12]}, not on this loop")

    @property
    def certificate(self) -> dict[str, Any] | None:
        """The verdict as JSON, with the digits that every machine comes to: what the log holds."""
        return None if self.verdict is None else self.verdict.on_every_machine()

    def start_controller(self) -> RunningController | MultiSampleController:
        """Return the control law, ready for slot 0."""
        return self.controller.start(self.model)

    def reference(self) -> Piecewise:
        """Return the reference, slot by slot."""
        e = self.experiment
        zero = (0.0,) * len(e.plant.outputs)
        return Piecewise(zero, {round(s.at / e.period): s.value for s in e.reference})

    def disturbance(self) -> Piecewise:
        """Return the input disturbance, slot by slot."""
        e = self.experiment
        zero = (0.0,) * len(e.plant.inputs)
        changes: dict[int, tuple[float, ...]] = {}
        pulses = [(round(p.at / e.period), round(p.at / e.period) + p.samples, p.value) for p in e.disturbance]
        for k in sorted({edge for a, b, _ in pulses for edge in (a, b)}):
            active = [v for a, b, v in pulses if a <= k < b]
            changes[k] = tuple(map(sum, zip(zero, *active)))
        return Piecewise(zero, changes)


def digest_of(experiment: Experiment, controller: Controller, model: LoopModel) -> str:
    """Return the digest of the loop that will run: its plant, controller, network, period and model, not its seed or schedule."""
    resolved = replace(experiment, controller=controller).resolved()
    said: dict[str, Any] = {
        name: resolved[name] for name in ("plant", "controller", "network", "period", "fault") if name in resolved
    }
    if experiment.limits.passivity is not None:  # the other limits stop a run; this one changes it
        said["passivity"] = resolved["limits"]["passivity"]
    law = f"{type(controller).__module__}.{type(controller).__qualname__}"  # two laws may have the same parameters
    return digest({**said, "control law": law, "A": model.A, "B": model.B, "C": model.C})
