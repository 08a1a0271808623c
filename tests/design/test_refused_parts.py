"""What parts of a design may be, up to its edges: shapes that fit each other, and what a proof or a controller can take."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from design.as_printed import chapter2_system
from design.as_printed.chapters_5_and_6 import inner_loop
from design.controllers import LoopModel
from design.controllers.historical import Historical
from design.controllers.linear_law import LinearLaw
from design.controllers.one_row import Constant
from design.controllers.rendered_wall import Coupler
from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.controllers.sensor_nodes import PacketWindow, Turns
from design.controllers.smith import Smith
from design.controllers.virtual_wall import VirtualWall
from design.controllers.wall import MATERIALS
from design.errors import DesignError, FieldError
from design.historical_data import DelayedPlant
from design.identification import LEAST_SAMPLES, Record
from design.identification.output_error import identify_axis
from design.jump_linear import MJLS
from design.lmi import prove, prove_inequalities
from design.monte_carlo.confidence import deviation_interval, mean_interval
from design.monte_carlo.jump_loop import JumpLoop
from design.monte_carlo.studies import mjls_energies
from design.networked_loop import check_plant_shapes
from design.networked_loop.closed_loop import dynamic_loop
from design.passivity.transparency import distortion
from design.processes.delay_chain import DelayChain
from design.processes.partitions import equal_probability, uniform
from design.processes.rates import PiecewiseLinearRate, constant_rate
from design.processes.semi_markov import FaultDetection, SemiMarkov
from design.requests.scheduled import RobustScheduled
from design.semi_markov_loop import JumpSystem, NormBounded
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.fault_tolerant_analysis import Siqc, check_loop
from design.semi_markov_loop.period_moments import Box, period_moments
from design.semi_markov_loop.sojourn_grid import refine
from design.tracking import TrackingProblem
from design.tracking.local_design import game_feedback, lqr_feedback

ONE = SemiMarkov(rates=((None,),))
TWO = SemiMarkov(rates=((None, constant_rate(1.0)), (constant_rate(1.0), None)))
MODEL = LoopModel(A=np.diag([0.5, 0.6]), B=np.ones((2, 1)), C=np.ones((1, 2)), period_s=0.1, tau_max=1, d_max=1)
PLANT = {"A": np.eye(2), "delayed": np.zeros((3, 2, 2)), "B": np.ones((2, 1)), "weight": np.eye(2), "input_weight": np.eye(1)}
SYSTEM = JumpSystem(a=np.zeros((2, 1, 1)), b=np.ones((2, 1, 1)), c=np.ones((2, 1, 1)), e=np.ones((2, 1, 1)))
BOUNDED = NormBounded(e=np.ones((2, 1, 2)), fa=np.ones((2, 1, 1)), fb=np.ones((2, 1, 1)))
SQUARE = NormBounded(e=np.ones((2, 1, 1)), fa=np.ones((2, 1, 1)), fb=np.ones((2, 1, 1)))
LOOP = {"system": SYSTEM, "gain": constant_gain(np.zeros((2, 1, 1))), "process": TWO, "start": (1.0,)}
MOVING = ScheduledGain(gain=np.zeros((2, 2, 1, 1)), starts_s=np.array([[0.0, 1.0]] * 2), schedule="linear")
RECORD = {"u": np.zeros(LEAST_SAMPLES), "y": np.zeros(LEAST_SAMPLES), "period_s": 0.1}
LAW = {"A": np.zeros((3, 3)), "B": np.zeros((3, 1)), "C": np.zeros((1, 3)), "D": np.zeros((1, 1))}
SOFT = Coupler(taps_m_per_n=(0.1, 0.2))
SUMMED = Coupler(taps_m_per_n=(0.1,), integrator_m_per_n=0.5)
LEAVES_LATE = SemiMarkov(
    rates=((None, PiecewiseLinearRate(times_s=(0.0, 1.0, 1.0), values=(1.0, 1.0, 0.0))), (constant_rate(1.0), None))
)
"""It leaves mode 0 with probability 1 - 1/e."""


def history(*gains: Any) -> Historical:
    return Historical(gains=gains)


def started(controller: Any) -> object:
    return controller.start(MODEL)


def plant(**values: Any) -> DelayedPlant:
    return DelayedPlant(**(PLANT | values))


def record(**values: Any) -> Record:
    return Record(**(RECORD | values))


def loop(**values: Any) -> JumpLoop:
    return JumpLoop(**(LOOP | values))


def faults(*detection: SemiMarkov) -> FaultDetection:
    return FaultDetection(failure=TWO, detection=detection, failure_restarts_detection_clock=True)


def siqc(g11: Any = ((1.0,),), g12: Any = ((0.0,),), g22: Any = ((-1.0,),)) -> Siqc:
    return Siqc(g11=g11, g12=g12, g22=g22)


def driven(**values: Any) -> object:
    once = DelayChain(transition=((1.0,),))
    return dynamic_loop(MODEL.A, MODEL.B, MODEL.C, once, once, LinearLaw(**(LAW | values)))


def tracked(**values: Any) -> TrackingProblem:
    given = {"A": [[0.5]], "B": [[1.0]], "C": [[1.0]], "sc": [[1.0]], "ca": [[1.0]], "R": 0.1, "objective": "h2"}
    return TrackingProblem(**(given | values))


def moments(system: JumpSystem, upper: bool) -> object:
    box = Box(low=np.ones(2), high=np.ones(2))
    return period_moments(system, [box, box], 0.1, 0, upper, slack=1.0)


def bent(coupler: Coupler) -> MJLS:
    return distortion(MATERIALS, np.full((3, 3), 1.0 / 3.0), coupler, period_s=1e-3, delay=1, cutoff_hz=30.0)


def followed(**values: Any) -> object:
    given = {"runs": 2, "steps": 1, "start": np.zeros(bent(SOFT).order), "seed": 0}
    return mjls_energies(bent(SOFT), **(given | values))


NO_PROOF = JumpCertificate(method="exact", verdict="certified", reason="")
SKEW = np.array([[1.0, 0.5], [0.0, 1.0]])


@pytest.mark.parametrize(
    ("make", "field"),
    [
        *((lambda name=name, value=value: plant(**{name: value}), name) for name, value in (
            ("A", np.ones((2, 3))), ("delayed", np.zeros((3, 2, 3))), ("B", np.ones((3, 1))), ("weight", np.eye(3)),
            ("input_weight", np.eye(2)),
        )),
        (lambda: history((((1.0,), (1.0, 2.0)),)), "gains"),
        (history, "gains"),
        (lambda: history(((((1.0,),),),)), "gains"),
        (lambda: history((((1.0,),),), (((math.inf,),),)), "gains[1][0][0][0]"),
        (lambda: history((((1.0,),),), (((1.0,),), ((1.0,),))), "gains[1]"),
        (lambda: started(history((((1.0,), (1.0,)),))), "gains"),
        (lambda: started(history((((1.0,),),), (((1.0,),),))), "gains"),
        (lambda: started(Constant(value=(1.0, 2.0))), "value"),
        (lambda: started(Constant(value=())), "value"),
        (lambda: started(Smith(gain=((1.0, 2.0),))), "gain"),
        (lambda: VirtualWall(coupler=SOFT, samples=0), "samples"),
        (lambda: PacketWindow(turns=Turns(order=(0, 1), loss=0.1), length=0), "window"),
        (lambda: faults(TWO), "detection"),
        (lambda: faults(TWO, ONE), "detection[1]"),
        (lambda: PiecewiseLinearRate(times_s=(), values=()), "times_s"),
        (lambda: PiecewiseLinearRate(times_s=(0.0,), values=(1.0, 2.0)), "values"),
        (lambda: equal_probability(LEAVES_LATE, 3), "sections"),
        (lambda: siqc(g11=SKEW), "g11"),
        (lambda: siqc(g11=((1.0, 0.0),)), "g11"),
        (lambda: siqc(g11=((0.0,),)), "g11"),
        (lambda: siqc(g22=-SKEW), "g22"),
        (lambda: siqc(g22=((0.0,),)), "g22"),
        (lambda: siqc(g12=((0.0, 0.0),)), "g12"),
        (lambda: siqc(g12=((math.nan,),)), "g12"),
        (lambda: check_loop(replace(SYSTEM, c=None), faults(TWO, TWO)), "c"),
        (lambda: check_loop(replace(SYSTEM, e=None), faults(TWO, TWO)), "e"),
        (lambda: check_loop(replace(SYSTEM, uncertainty=BOUNDED), faults(TWO, TWO)), "uncertainty"),
        (lambda: check_loop(SYSTEM, faults(TWO, TWO), MOVING), "gain"),
        (lambda: SYSTEM.at_vertex(0), "uncertainty"),
        (lambda: replace(SYSTEM, uncertainty=BOUNDED).at_vertex(0), "uncertainty"),
        (lambda: JumpSystem(a=[[[1.0]], [[1.0, 2.0]]], b=np.ones((2, 1, 1))), "a"),
        (lambda: JumpSystem(a=np.eye(2), b=np.ones((2, 1, 1))), "a"),
        (lambda: JumpSystem(a=np.zeros((2, 1, 1)), b=np.ones((1, 1, 1))), "b"),
        (lambda: JumpSystem(a=np.zeros((2, 1, 1)), b=np.full((2, 1, 1), np.nan)), "b[0, 0, 0]"),
        (lambda: refine(TWO, uniform(TWO, 1), 0), "parts"),
        (lambda: moments(replace(SYSTEM, uncertainty=BOUNDED), False), "uncertainty"),
        (lambda: loop(gain=MOVING), "gain"),
        (lambda: loop(gain=constant_gain(np.zeros((3, 1, 1)))), "gain"),
        (lambda: loop(gain=constant_gain(np.zeros((2, 1, 2)))), "gain"),
        (lambda: loop(process=ONE), "process"),
        (lambda: loop(start=(1.0, 1.0)), "start"),
        (lambda: loop(start=(math.inf,)), "start"),
        *((lambda mode=mode: loop(mode=mode), "mode") for mode in (-1, 2)),
        (lambda: loop(uncertain=True), "uncertain"),
        (lambda: loop(uncertain=True, system=replace(SYSTEM, uncertainty=BOUNDED)), "uncertain"),
        *((lambda level=level: mean_interval([1.0, 2.0], level), "level") for level in (0.0, 1.0)),
        (lambda: deviation_interval([1.0, 2.0, 4.0], 1.0), "level"),
        (lambda: mean_interval([1.0, math.nan]), "values"),
        (lambda: prove(NO_PROOF), "certificate"),
        (NO_PROOF.check, "certificate"),
        (lambda: prove_inequalities([], {}, 24), "certificate"),
        (lambda: RobustScheduled(sections=2, starts_s=((0.0,), (0.0,))), "sections"),
        (lambda: RobustScheduled(sections=-1), "sections"),
        *((lambda name=name, value=value: RobustScheduled(**{name: value}), name) for name, value in (
            ("gain_bound", 0.0), ("gain_bound", math.inf), ("decay", -1e-9), ("decay", math.nan),
        )),
        *((lambda name=name, value=value: tracked(**{name: value}), name) for name, value in (
            ("seed", -1), ("starts", -1), ("hinf_bound", 1.0), ("objective", "h3"), ("method", "guess"),
        )),
        (lambda: tracked(objective="mixed", hinf_bound=0.0), "hinf_bound"),
        (lambda: driven(B=np.zeros((3, 2))), "laws[0]"),
        (lambda: driven(D=np.zeros((1, 2))), "laws[0]"),
        (lambda: driven(C=np.zeros((1, 2))), "laws[0]"),
        (lambda: check_plant_shapes([1.0], [[1.0]], [[1.0]]), "A"),
        (lambda: check_plant_shapes([[1.0]], [[math.inf]], [[1.0]]), "B"),
        (lambda: inner_loop(MATERIALS[0], SUMMED, 30.0), "coupler"),
        (lambda: bent(SUMMED), "coupler"),
        *((lambda name=name, value=value: followed(**{name: value}), name) for name, value in (
            ("steps", 0), ("seed", -1), ("start", (1.0,)), ("start", np.full(bent(SOFT).order, np.nan)), ("runs", 0),
        )),
    ],
)  # fmt: skip
def test_a_part_that_does_not_fit_is_refused_with_its_field(make: Callable[[], object], field: str) -> None:
    with pytest.raises(FieldError) as refused:
        make()
    assert refused.value.field == field


@pytest.mark.parametrize(
    "make",
    [
        plant, siqc, driven, followed,
        lambda: plant(input_weight=None),
        lambda: started(history((((1.0,),), ((2.0,),)))),
        lambda: started(Constant(value=(1.0,))),
        lambda: started(Smith(gain=((1.0,),))),
        lambda: VirtualWall(coupler=SOFT, samples=1),
        lambda: PacketWindow(turns=Turns(order=(0, 1), loss=0.1), length=1),
        lambda: faults(TWO, TWO),
        lambda: PiecewiseLinearRate(times_s=(0.0,), values=(0.0,)),
        lambda: equal_probability(LEAVES_LATE, 2),
        lambda: check_loop(SYSTEM, faults(TWO, TWO), constant_gain(np.zeros((2, 1, 1)))) is None,
        lambda: chapter2_system().at_vertex(0),
        lambda: refine(TWO, uniform(TWO, 1), 1),
        lambda: moments(replace(SYSTEM, uncertainty=BOUNDED), True),
        lambda: moments(SYSTEM, False),
        lambda: loop(mode=1),
        lambda: loop(uncertain=True, system=replace(SYSTEM, uncertainty=SQUARE)),
        lambda: mean_interval([1.0, 2.0], 0.999),
        lambda: RobustScheduled(sections=2),
        lambda: RobustScheduled(starts_s=((0.0,), (0.0,))),
        lambda: tracked(seed=0, starts=0),
        lambda: tracked(objective="mixed", hinf_bound=1e-9),
        lambda: check_plant_shapes([[1.0]], [[1.0]], [[1.0]]),
        lambda: inner_loop(MATERIALS[0], SOFT, 30.0),
        lambda: bent(SOFT),
        lambda: record(y=np.append(np.full(3, np.nan), np.zeros(LEAST_SAMPLES)), u=np.zeros(LEAST_SAMPLES + 3)),
    ],
)  # fmt: skip
def test_a_part_that_just_fits_is_taken(make: Callable[[], object]) -> None:
    assert make() is not None


@pytest.mark.parametrize(
    ("make", "said"),
    [
        *((lambda value=value: record(period_s=value), "period_s: .* above 0") for value in (0.0, -1.0, math.inf, math.nan)),
        (lambda: record(u=np.zeros(LEAST_SAMPLES + 1)), "two equal lengths"),
        (lambda: record(u=np.zeros((LEAST_SAMPLES, 1)), y=np.zeros((LEAST_SAMPLES, 1))), "two equal lengths"),
        (lambda: record(u=np.append(np.zeros(LEAST_SAMPLES - 1), math.nan)), f"input {LEAST_SAMPLES - 1} is missing"),
        (lambda: record(y=np.append(math.inf, np.zeros(LEAST_SAMPLES - 1))), "largest output is inf, expected 1e-30 to 1e.30"),
        (lambda: record(u=np.full(LEAST_SAMPLES, 1e-31)), "the largest input is 1e-31, expected 1e-30 to 1e.30"),
        (lambda: record(y=np.append(math.nan, np.zeros(LEAST_SAMPLES - 1))), f"{LEAST_SAMPLES - 1} outputs, expected at least"),
        (lambda: identify_axis([]), "records: none"),
        (lambda: identify_axis([record(), record(period_s=0.2)]), r"sample periods from 0\.1 to 0\.2 s"),
        (lambda: lqr_feedback(np.array([[2.0]]), np.zeros((1, 1)), np.eye(1), 0.1), "^lqr: "),
        (lambda: game_feedback(np.array([[2.0]]), np.zeros((1, 1)), np.eye(1), 0.1), "hinf: the game Riccati equation has no"),
    ],
)  # fmt: skip
def test_what_no_design_can_be_made_of_is_said(make: Callable[[], object], said: str) -> None:
    with pytest.raises(DesignError, match=said):
        make()
