"""An experiment, composed: plug-ins made, the design solved, its certificate computed. What every process of a run receives."""

from __future__ import annotations

import dataclasses
import sys
from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from msgspec.structs import replace
from threadpoolctl import threadpool_limits

from design.controllers import (
    Controller,
    FromSamples,
    GainTable,
    HistoryGains,
    IntegralAction,
    LinearFeedback,
    LoopModel,
    RunningController,
    packet_samples,
    row_count,
)
from design.errors import DesignError, FieldError
from design.requests.task import DesignTask
from design.verdict import Verdict
from hil.certify.certifier import LoopToCertify
from hil.certify.certify import certify as certified
from hil.certify.certify import digest_of, of_external
from hil.certify.historical_loop import delayed_plant_of, known_past, mask_faults
from hil.certify.jump_plant import process_of, system_of
from hil.certify.stated_controller import stated_by
from hil.certify.watched import Watched, one_step
from hil.compose.fit import check_own, check_references, size_faults
from hil.compose.law_files import with_law_files
from hil.compose.stored_gains import Gains, problem_digest, solve_controller
from hil.errors import ExperimentError, ForeignVerdict
from hil.experiment import Experiment
from hil.experiment.absent import Absent
from hil.experiment.table_check import fault_at
from hil.log.records import Channel
from hil.log.topics import Logged, channels
from hil.plugins.own_modules import is_own
from hil.plugins.protocols import Designer, GivesGains, JumpPlant, NamedController
from hil.plugins.registry import OBJECT
from hil.rig.delay_chains import delay_chains, initial_laws, node_chains, why_no_chain, within_reach, without_held
from hil.rig.packet_ages import neglects
from hil.rig.port import Port, port_of
from hil.rig.sensor_list import Sensor, sensors_of
from hil.rig.sensors import Shared, sensor_nodes, shared_media
from plants.errors import PlantError
from transport.laws.protocols import NetworkLaw, prepare
from transport.packets import MAX_OUTPUTS

if TYPE_CHECKING:
    from design.processes.delay_chain import DelayChain


NOT_COMPARED = "the plant keeps to its model beyond the test: in the run it is not compared"


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """What is needed to run: plain data, cheap to pickle.

    Args:
        experiment: the checked description.
        model: what the controller knows of the plant, and the bounds of both delays.
        controller: controller parameters, with any design already solved.
        ca_law: the network to the actuator, distributions tabulated: no process that keeps time computes them.
        rows: rows in one send-all packet.
        selection: how the actuator picks one of them.
        samples: samples that the controller takes from a node: the newest, and so many less one before it.
        sensors: the sensor nodes, by number, their laws tabulated too.
        media: what they share on their way to the controller.
        verdict: what is claimed of the closed loop, None if nobody asked.
        gains: where solved gains come from; None where the experiment itself has them.
        port: force and position of a device under one force, None for another plant.
        watched: what the run is compared with; None where no claim rests on it.
    """

    experiment: Experiment
    model: LoopModel
    controller: Controller
    ca_law: NetworkLaw
    rows: int
    selection: str
    samples: int
    sensors: tuple[Sensor, ...]
    media: tuple[Shared, ...]
    verdict: Verdict | None
    gains: Gains | None = None
    port: Port | None = None
    watched: Watched | None = None

    def __post_init__(self) -> None:
        if self.verdict is not None and self.verdict.digest != digest_of(self.experiment, self.controller, self.model):
            raise ForeignVerdict(f"verdict: it is on system {self.verdict.digest[:12]}, not on this loop")

    @property
    def certificate(self) -> dict[str, Any] | None:
        """The verdict as JSON."""
        return None if self.verdict is None else self.verdict.to_json()

    def start_controller(self) -> RunningController | FromSamples:
        """Return the control law, ready for slot 0."""
        return self.controller.start(self.model)

    def channels(self, *, on_can: bool = False) -> dict[str, Channel]:
        """Return the topics that a run of this loop logs.

        Args:
            on_can: the link of the session is a CAN link.
        """
        plant = self.experiment.plant
        passivity = self.experiment.limits.passivity is not None
        return channels(Logged(
            states=plant.states, inputs=plant.inputs, outputs=plant.outputs, n_rows=self.rows,
            numbered=any(sensor.numbered for sensor in self.sensors), passivity=passivity,
            on_can=on_can,
        ))  # fmt: skip

    def reference(self) -> Callable[[int], tuple[float, ...]]:
        """Return the reference as a function of the slot."""
        e = self.experiment
        zero = (0.0,) * len(e.plant.outputs)
        return _schedule(zero, [(round(s.at / e.period), s.value) for s in e.reference])

    def disturbance(self) -> Callable[[int], tuple[float, ...]]:
        """Return the input disturbance as a function of the slot."""
        e = self.experiment
        zero = (0.0,) * len(e.plant.inputs)
        changes: dict[int, tuple[float, ...]] = {}
        pulses = [(round(p.at / e.period), round(p.at / e.period) + p.samples, p.value) for p in e.disturbance]
        for k in sorted({edge for a, b, _ in pulses for edge in (a, b)}):
            active = [v for a, b, v in pulses if a <= k < b]
            changes[k] = tuple(map(sum, zip(zero, *active)))
        return _schedule(zero, list(changes.items()))


def _schedule(start: tuple[float, ...], changes: Sequence[tuple[int, tuple[float, ...]]]) -> Callable[[int], tuple[float, ...]]:
    """Piecewise constant in the slot; it is looked up where a piece begins."""
    ordered = sorted(changes)
    edges = [k for k, _ in ordered]
    values = [start, *(v for _, v in ordered)]
    begins, ends = [-sys.maxsize, *edges], [*edges, sys.maxsize]
    begin = end = 0
    value = start

    def at(k: int) -> tuple[float, ...]:
        nonlocal begin, end, value
        if not begin <= k < end:
            piece = bisect_right(edges, k)
            begin, end, value = begins[piece], ends[piece], values[piece]
        return value

    return at


def compose(experiment: Experiment, *, certify: bool = True, external: bool = False) -> Loop:
    """Make the loop of an experiment: check what belongs together, solve the design, certify the closed loop.

    Args:
        experiment: the checked description.
        certify: whether to say what can be claimed of the loop.
        external: somebody else's controller answers on the link: of its loop nothing is known.

    Raises:
        ExperimentError: if sizes do not fit, or the loop has no certificate of mean-square stability and ``allow_uncertified`` is
            not set.
    """
    with _small_matrices():
        return _compose(experiment, certify, external)


def solved_gains(experiment: Experiment) -> tuple[NamedController, str] | None:
    """Solve the gains that an experiment asks for, whatever is stored; return them and the digest of their problem.

    None where the experiment itself gives the gains.

    Raises:
        ExperimentError: no gains meet the request, or the problem has no digest.
    """
    asked: Any = experiment.controller
    if not isinstance(asked, Designer) or (isinstance(asked, GivesGains) and asked.gains_given):
        return None
    with _small_matrices():
        experiment, model = _modelled(experiment)
        try:
            task = _task(experiment, model)
            return asked.solve(task), problem_digest(asked, task)
        except (ValueError, DesignError) as e:
            raise ExperimentError(experiment.name, [fault_at("controller", e)]) from e


@contextmanager
def _small_matrices() -> Iterator[None]:
    # A second BLAS thread costs time on a quiet machine and minutes on a busy one.
    # What overflows is judged where its number is: certificates say undecided, a run is stopped by its limits.
    with threadpool_limits(1, user_api="blas"), np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        yield


def _modelled(experiment: Experiment) -> tuple[Experiment, LoopModel]:
    """Return the experiment with its laws' files read, and what the controller knows of its plant."""
    lost = [str(part.missing()) for part in (experiment.plant, experiment.controller) if isinstance(part, Absent)]
    faults = lost or size_faults(experiment)
    if faults:
        raise ExperimentError(experiment.name, faults)
    experiment = with_law_files(experiment)
    plant, links = experiment.plant, experiment.links
    try:
        discrete = plant.model().discretise(float(experiment.period))
    except PlantError as e:
        raise ExperimentError(experiment.name, [f"period: {e}"]) from e
    return experiment, LoopModel(
        A=np.asarray(discrete.A),
        B=np.asarray(discrete.B),
        C=np.asarray(discrete.C),
        period_s=float(experiment.period),
        tau_max=links.sc.max_age,
        d_max=links.ca.max_age,
        sensors=sensor_nodes(experiment),
    )


def _compose(experiment: Experiment, certify: bool, external: bool) -> Loop:
    experiment, model = _modelled(experiment)
    plant, links = experiment.plant, experiment.links
    controller: Controller
    gains: Gains | None = None
    try:
        if isinstance(experiment.controller, Designer):  # a design problem: what runs is its solution
            solved, gains = solve_controller(experiment, _task(experiment, model))
            controller = solved
            experiment = replace(experiment, controller=solved, kinds={**experiment.kinds, "controller": solved.kind})
        else:
            controller = experiment.controller
        kind = experiment.kinds.get("controller", "")
        if is_own(kind) or kind.startswith(OBJECT):
            check_own(controller, model)
        running = controller.start(model)
        sc, ca = delay_chains(experiment)
        samples = packet_samples(controller)
        check_references(experiment, controller, model)
        sensors = tuple(sensor.prepared() for sensor in sensors_of(experiment))
        if samples > 1 and (len(sensors) > 1 or sensors[0].buffer < samples):
            raise FieldError("samples", f"{samples} in one packet, but no node alone sends so many samples of every output")
        if not 1 <= samples * len(plant.outputs) <= MAX_OUTPUTS:
            raise FieldError("samples", f"{samples} of {len(plant.outputs)} outputs, a packet carries 1 to {MAX_OUTPUTS} values")
    except (ValueError, DesignError) as e:
        raise ExperimentError(experiment.name, [fault_at("controller", e)]) from e
    if isinstance(controller, HistoryGains):
        unknown = mask_faults(controller, model.nodes)
        if unknown:
            raise ExperimentError(experiment.name, unknown)
    verdict, watched = None, None
    if certify:
        judged = _judged(experiment, controller, model, sc, ca, running.selection)
        verdict = certified(judged)
        watched = _watched(judged, verdict, external)
        if watched is not None and watched.plant is None and watched.claimed:
            verdict = dataclasses.replace(verdict, assumptions=(*verdict.assumptions, NOT_COMPARED))
    if verdict is not None and external:
        verdict = of_external(verdict, experiment.kinds.get("controller", ""))
    elif verdict is not None:
        _allow(experiment, verdict)
    return Loop(
        experiment=experiment,
        model=model,
        controller=controller,
        ca_law=prepare(links.ca.law),
        rows=row_count(running.selection, model.d_max),
        selection=running.selection,
        samples=samples,
        sensors=sensors,
        media=shared_media(experiment),
        verdict=verdict,
        gains=gains,
        port=port_of(plant),
        watched=watched,
    )


def _task(e: Experiment, model: LoopModel) -> DesignTask:
    """Return what a design has to solve: the loop with the plant's own matrices and rates."""
    plant, (sc, ca) = e.plant, delay_chains(e)
    chainless = why_no_chain(e)
    if not isinstance(e.controller, IntegralAction):  # the designs of Chapter 7 state it; others have no packets in their theory
        sc, ca = without_held(sc), without_held(ca)
        chainless = chainless or "the theory of this design has no packet laws"
    jumps: dict[str, Any] = {}
    if isinstance(plant, JumpPlant):
        try:
            jumps = {"jump_system": system_of(plant.jump_system()), "jump_process": process_of(plant.jump_process())}
        except ValueError as error:
            raise FieldError("kind", f"no design covers this plant: {error}") from error
    delayed = delayed_plant_of(plant, model)
    initial = None if delayed is None else known_past(plant)[0]
    return DesignTask(
        model=model, sc=sc, sc_nodes=node_chains(e) or (), ca=ca, folder=e.folder, delayed_plant=delayed, initial_state=initial,
        chainless=chainless, **jumps,
    )  # fmt: skip


def _watched(judged: LoopToCertify, verdict: Verdict, external: bool) -> Watched | None:
    """Return what the run of a loop is compared with: what its certificate rests on, and the plant of an external controller.

    A controller that states itself, word for word, is not compared with itself.
    """
    if not verdict.certified and not external:
        return None
    stated = None if external else stated_by(judged)
    twin = None if stated is None else stated[0]
    if twin is not None and type(twin) is type(judged.controller):
        twin = None
    return Watched(plant=one_step(judged.plant, judged.motion), controller=twin, claimed=not external)


def _judged(
    e: Experiment, controller: Controller, model: LoopModel, sc: DelayChain | None, ca: DelayChain | None, selection: str
) -> LoopToCertify:
    """Return the loop of the controller that is named, as it is judged."""
    own, unmet, chainless, left = digest_of(e, controller, model), "", "", ""
    begun = initial_laws(e)
    if not isinstance(controller, GainTable | LinearFeedback):
        sc, ca = without_held(sc), without_held(ca)
    if sc is None or ca is None:
        chainless = why_no_chain(e) or "the theory of this controller has no packet laws"
    elif begun is not None:
        left = neglects(e)
        modes = sc.modes, ca.modes
        sc, ca = within_reach(sc, begun[0]), within_reach(ca, begun[1])
        if (sc.modes, ca.modes) != modes:
            never = sum(modes) - sc.modes - ca.modes
            unmet = f"the network begins as its laws state: it never comes to {never} of their modes"
    return LoopToCertify(
        plant=e.plant, controller=controller, model=model, sc=sc, ca=ca, digest=own,
        damped=e.limits.passivity is not None, faults=len(e.fault),
        input_limits=e.limits.input, state_limits=e.limits.state, selection=selection,
        unmet=unmet, chainless=chainless, neglects=left,
    )  # fmt: skip


def _allow(e: Experiment, verdict: Verdict) -> None:
    """Refuse to run a loop without a certificate, unless the experiment allows it."""
    if verdict.certified or e.allow_uncertified:
        return
    raise ExperimentError(
        e.name,
        [
            f"controller: no certificate of {verdict.kind}, {verdict.state}: {verdict.reason}; "
            "set allow_uncertified = true to run it all the same"
        ],
    )
