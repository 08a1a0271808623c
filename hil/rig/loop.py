"""What is needed to run an experiment: composed once, received by every process of the run; and what the run is compared with.

It has the digest of what is judged, the model of its plant, slot by slot, and the table of its controller. The test before a run,
`hil.certify.conformance`, ends after some slots. A plant or controller that departs from its statement later, at larger inputs or
in another state is found by the comparison in the run alone. Both use the tolerances of this file, and `kind_of` for the motion
that no model explains.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from msgspec import Struct
from msgspec.structs import replace
from numpy.typing import NDArray

from design.controllers import Controller, LoopModel, MultiSampleController, RunningController
from design.errors import FieldError
from design.verdict import Verdict, digest
from hil.errors import ForeignVerdict, located
from hil.experiment import Experiment
from hil.rig import RigSpec
from hil.rig.delay_chains import Chains
from hil.rig.schedules import Piecewise, disturbance_changes

if TYPE_CHECKING:
    from design.controllers import Controller


Array = NDArray[np.float64]
Running = RunningController | MultiSampleController

EQUAL = 1e-6
"""Share of the motion by which a plant may miss its model and still agree: rounding, and the error of a fine integrator."""
CANCELS = 1e-11
"""Rounding error of the difference of two runs, as a share of their states."""
LARGEST = 1e60
RUN_AGAIN = 20_000
"""Slots with loads or noise for which the plant is run a second time: each costs as much as a slot of the plant."""


class OneStep(Struct, frozen=True, kw_only=True):
    """The equation error of a plant's record: e(k) = sum_i taps[i] z(k - i), 0 in every slot if it moves by its model.

    z(k) = (x, y, u + w) in slot k. Loads and noise remain in e.

    Args:
        taps: (h + 1, q, width of z).
        names: name and unit of every row of e.
        stated: the inputs of its own that the plant states, see `HasOwnInputs`.
    """

    taps: Array
    names: tuple[tuple[str, str], ...]
    stated: tuple[str, ...] = ()


class JumpStep(Struct, frozen=True, kw_only=True):
    """The bound of a plant's record in a slot without a jump: |x(k+1) - F_i x(k) - G_i v| <= W_i (|x(k)|, |v|), v = u + w.

    Args:
        flows: [F_i G_i], (N, n, n + m).
        bands: W_i, (N, n, n + m); zero where the matrices are certain.
        seen: whether the measured mode is the true one; else the true mode may be any.
        unseen: mean number of jumps in a slot that begins and ends in the same mode.
        names: name and unit of every state.
    """

    flows: Array
    bands: Array
    seen: bool
    unseen: float
    names: tuple[tuple[str, str], ...]


class Watched(Struct, frozen=True, kw_only=True):
    """The comparisons of a run.

    Args:
        plant: equation of the plant's record; None: the plant is not compared.
        controller: the controller that the running one states; None: it is not compared.
        claimed: whether a certificate rests on the comparisons.
        laws: indices, among the laws of the rig, of the user's own network laws that state a chain.
    """

    plant: OneStep | JumpStep | None
    controller: Controller | None
    claimed: bool
    laws: tuple[int, ...] = ()


Free = Literal["none", "constant", "noise", "moves", "not compared"]
ROUNDING = 1e-9
STEPS = 4
"""Slots in which a load may begin or end."""
GROWTH = 3.0
"""Ratio of the noise's last third to its first that shows growth: of stationary noise one in 1e20 runs of 300 slots has it."""


class FreeMotion(NamedTuple):
    """The residual of a motion without inputs, the model's motion subtracted: its kind, its size, name and unit of its signal."""

    kind: Free
    size: float = 0.0
    signal: tuple[str, str] = ("", "")


def kind_of(residual: Array, other: Array, sizes: Array, signals: list[tuple[str, str]]) -> FreeMotion:
    """Return the kind of a residual: nothing, a constant load, stationary noise, or a motion that the model lacks.

    Args:
        residual: of a run, in every slot, (slots, q).
        other: of a second run.
        sizes: of the states, whose rounding counts as no motion.
        signals: name and unit of every column.
    """
    count = min(len(residual), len(other))
    scale = ROUNDING * np.maximum.accumulate(np.abs(sizes)).max(axis=1, keepdims=True)[: len(residual)] + 1e-300
    scale = scale + ROUNDING * np.abs(sizes[0]).max()
    if not (np.abs(residual) > scale).any():
        return FreeMotion("none")
    k, i = np.unravel_index(int(np.abs(residual).argmax()), residual.shape)
    found = (float(abs(residual[k, i])), signals[int(i)])
    third = max(len(residual) // 3, 1)
    if (np.abs(residual[:count] - other[:count]) > scale[:count]).any():
        early, late = (float(np.sqrt((part * part).mean())) for part in (residual[:third], residual[-third:]))
        return FreeMotion("moves" if late > GROWTH * early + float(scale.max()) else "noise", *found)
    changes = int((np.abs(np.diff(residual, axis=0)) > 2.0 * scale[1 : len(residual)]).any(axis=1).sum())
    return FreeMotion("constant" if changes <= STEPS else "moves", *found)


def looks_back(running: Running) -> int | None:
    """Return the age in slots of the oldest sample that a running controller is handed; None where it gets the newest alone."""
    return running.memory if isinstance(running, MultiSampleController) else None


def handed(running: Running) -> str:
    """Return a phrase that says which samples a running controller is handed."""
    memory = looks_back(running)
    return "takes the newest sample alone" if memory is None else f"takes every sample of the last {memory + 1} slots"


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

    def assuming(self, *assumptions: str) -> Loop:
        """Return the loop with further assumptions of its certificate; without a certificate it is the same."""
        if self.verdict is None or not self.verdict.certified:
            return self
        return dataclasses.replace(self, verdict=self.verdict.assuming(*assumptions))

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
        return Piecewise((0.0,) * len(self.experiment.plant.inputs), disturbance_changes(self.experiment))


def digest_of(experiment: Experiment, controller: Controller, model: LoopModel) -> str:
    """Return the digest of the loop that will run: its plant, controller, network, period and model, not its seed or schedule.

    Raises:
        HilError: a plant, controller or law that was built in Python has a table whose keys have no order.
    """
    resolved = replace(experiment, controller=controller).resolved()
    said: dict[str, Any] = {
        name: resolved[name] for name in ("plant", "controller", "network", "period", "fault") if name in resolved
    }
    if experiment.limits.passivity is not None:  # the other limits stop a run; this one changes it
        said["passivity"] = resolved["limits"]["passivity"]
    law = f"{type(controller).__module__}.{type(controller).__qualname__}"  # two laws may have the same parameters
    with located(experiment.name, FieldError):
        return digest({**said, "control law": law, "A": model.A, "B": model.B, "C": model.C})
