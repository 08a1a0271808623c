"""How much uncertainty of its plant a design bears: the small-gain theorem, one quadratic family, the plants at the ends."""

import dataclasses
import json
from functools import cache
from typing import ClassVar

import numpy as np
import pytest
from click.testing import CliRunner
from msgspec import structs

from design.networked_loop.certify import certify_structure
from design.processes.delay_chain import DelayChain
from design.requests.tracking import LocalDesigned, solve_tracking
from design.tracking.synthesis import certified
from hil.cli.design import command
from hil.cli.design.gains import design_local
from hil.compose import compose
from hil.design_questions import TrackingTarget, plant_uncertainty, problem_for, tracking_target, verdict_on
from hil.design_questions.plant_uncertainty import interval, judge_uncertain, plants_between
from hil.errors import HilError
from hil.experiment import load_experiment
from plants import DCMotor, LinearPlant, LinearRun, Signal, StateSpace, TransferFunction
from plants.parts.actuators import Friction


def answered(*arguments):
    return json.loads(CliRunner().invoke(command, [*arguments, "--json"], catch_exceptions=False).stdout)


@cache
def plain_design():
    target = tracking_target("dc-motor")
    return target, solve_tracking(problem_for(target, starts=1))


def test_robust_gains_run_in_their_own_loop_and_are_not_solved_for_another(tmp_path):
    asked = ("dc-motor-hinf", "--information", "constant", "--starts", "1", "--uncertainty", "gain=30%")
    plain = answered(*asked)
    path = tmp_path / "robust.json"
    robust = answered(*asked, "--robust", "-o", str(path))
    assert robust["robust"] and not plain["robust"] and robust["uncertainty"]["state"] == "certified"
    assert robust["uncertainty"]["margin"] > plain["uncertainty"]["margin"]
    controller = f"controller={{kind='designed', file='{path}'}}"
    assert compose(load_experiment("dc-motor-hinf", [controller])).controller.gains[0][0][0][0] == robust["gains"][0][0][0][0]
    with pytest.raises(HilError, match=r"robust gains are for their own loop \(B of the plant"):
        compose(load_experiment("dc-motor-hinf", [controller, "plant.gain=100"]))


def test_uncertainty_is_borne_undecided_or_refused_by_its_size():
    """The plants at the ends are the plant's own, and the guaranteed norms are above the nominal ones."""
    sure = answered("dc-motor", "--starts", "1", "--uncertainty", "gain=5%")
    reported = sure["uncertainty"]
    assert reported["state"] == "certified" and reported["number"] < reported["limit"] == 1.0
    assert reported["h2_norm"] > sure["norms"]["h2"] and reported["hinf_norm"] > sure["norms"]["hinf"]
    (one,) = reported["parameters"]
    assert one["low"] == pytest.approx(0.95 * 172.38) and reported["digest"] != sure["verdict"]["digest"]
    target, design = plain_design()
    louder = structs.replace(design, gains=1.5 * design.gains)  # stable, with less to spare
    states = [judge_uncertain(target, louder, [interval(target.of, f"gain={width}%")]).state for width in (20, 50)]
    assert states == ["undecided", "refused"]


def test_a_step_of_the_reference_counts_as_that_of_the_nominal_plant_and_the_verdict_says_so():
    """Of a plant at an end the norm of this deviation is below the guaranteed one; its own step would leave an offset."""
    target = tracking_target("dc-motor")
    design = solve_tracking(problem_for(target, starts=1, order=1, R=0.5, reference_weight=3.0))
    width = interval(target.of, "gain=4%")
    verdict, nominal = judge_uncertain(target, design, [width]), design.problem.structure()
    assert verdict.certified and plant_uncertainty.NOMINAL_STEP in verdict.assumptions
    assert plant_uncertainty.NOMINAL_STEP not in judge_uncertain(*plain_design(), [width]).assumptions
    for change in plants_between(target, design, [width]).ends:
        A, B = np.hsplit(np.hstack([target.A, target.B]) + change, [len(target.A)])
        structure = dataclasses.replace(design.problem, A=A, B=B).structure()
        driven = structs.replace(structure, B=np.append(structure.B[:, :, :1], nominal.B[:, :, 1:], axis=2))
        found = certify_structure(driven, design.gains, output="stacked")
        assert design.certificate.h2_norm != found.h2_norm < verdict.details["h2_norm"]


def test_one_family_decides_where_the_small_gain_theorem_proves_less():
    target, design = plain_design()

    def judged(gain, pole):
        return judge_uncertain(target, design, [interval(target.of, f"gain={gain}%"), interval(target.of, f"pole={pole}")])

    found = judged(15, 0.7)
    assert found.certified and "quadratic family" in found.method and found.number < found.limit == 1.0
    assert 0.8 < found.details["margin"] < 0.95 and found.details["worst_radius_at_the_ends"] < found.number
    wider = judged(20, 1.0)
    assert wider.state == "undecided" and "no quadratic family was found" in wider.reason
    assert wider.details["growth_of_one_family"] > 1.0 and judged(20, 1.5).state == "refused"


def test_what_a_plant_has_beyond_its_model_leaves_a_design_undecided():
    """Friction and an encoder that rounds are in no proof of a design; the same gains over the plain motor are certified."""
    target, plain = tracking_target("dc-motor-h2-friction"), tracking_target("dc-motor").of
    design = solve_tracking(problem_for(target, starts=1))
    verdict = verdict_on(target, design)
    assert verdict.state == "undecided" and "friction" in verdict.reason
    assert verdict_on(target._replace(of=plain), design).state == "certified"
    assert judge_uncertain(target, design, [interval(target.of, "gain=1%")]).state == "undecided"
    for of, state in ((target.of, "undecided"), (plain, "refused")):
        assert design_local(target._replace(of=of), LocalDesigned(method="lqr"))["verdict"]["state"] == state


def test_viscous_friction_moves_the_pole_that_a_design_is_judged_with():
    """The gains are made for the model that a designer sees; the verdict is on the motion, and between them is an uncertainty."""
    target, design = plain_design()
    motor, asked = target.of, [interval(target.of, "gain=0.1%")]
    rubbing = target._replace(of=dataclasses.replace(motor, friction=Friction(viscous_v_s_per_rad=0.1)))
    faster = target._replace(of=dataclasses.replace(motor, pole=motor.pole + 0.1 * motor.gain))
    plain, found = verdict_on(target, design), verdict_on(rubbing, design)
    assert found.number == verdict_on(faster, design).number < plain.number and found.digest != plain.digest
    margins = [judge_uncertain(each, design, asked).details["margin"] for each in (rubbing, target)]
    assert margins[0] < 0.01 * margins[1]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tank:
    """A level that is the volume over the area; it may move by another equation than it states."""

    area: float = 1.0
    moves_as_said: bool = True
    inputs: ClassVar = (Signal("flow", "m^3/s"),)
    outputs: ClassVar = (Signal("level", "m"),)
    states: ClassVar = (Signal("volume", "m^3"),)

    def model(self):
        return StateSpace(A=[[-0.1]], B=[[1.0]], C=[[1.0 / self.area]])

    def start(self, rng):
        return LinearRun(self.model() if self.moves_as_said else StateSpace(A=[[3.0]], B=[[-1.0]], C=[[1.0]]), (0.0,))


def test_a_design_for_a_plant_of_ones_own_is_judged_by_what_the_plant_does():
    moves = Tank().model().discretise(0.05)
    target = tracking_target("dc-motor")._replace(A=moves.A, B=moves.B, C=moves.C, of=Tank())
    design = solve_tracking(problem_for(target, starts=1))
    honest = verdict_on(target, design)
    assert honest.certified and any("moves as its model says" in each for each in honest.assumptions)
    lying = target._replace(of=Tank(moves_as_said=False))
    assert verdict_on(lying, design).state == "refused" and "does not move as its model()" in verdict_on(lying, design).reason
    assert design_local(lying, LocalDesigned(method="lqr"))["verdict"]["state"] == "refused"
    with pytest.raises(HilError, match=r"--uncertainty: area: changes what the plant measures \(C\)"):
        judge_uncertain(target, design, [interval(target.of, "area=50%")])


@pytest.mark.parametrize("names", [("gain=10%",), ("pole=30%",), ("gain=5%", "pole=20%")])
def test_every_plant_between_is_covered(names):
    """Plants of random parameters, none of them on the grid, lie in the set that the matrices describe."""
    target, design = plain_design()
    intervals = [interval(target.of, said) for said in names]
    found = plants_between(target, design, intervals)
    rng = np.random.default_rng(1)
    for _ in range(40):
        values = {i.name: float(rng.uniform(i.low, i.high)) for i in intervals}
        other = dataclasses.replace(target.of, **values).model().discretise(0.05)
        change = np.hstack([other.A - target.A, other.B - target.B])
        N = np.hstack([found.N1, found.N2])
        delta = np.linalg.pinv(found.M) @ change @ np.linalg.pinv(N)
        assert np.linalg.norm(delta, 2) <= 1.0 + 1e-9
        np.testing.assert_allclose(found.M @ delta @ N, change, atol=1e-10)


@pytest.mark.parametrize("unit", [1e-14, 1.0, 1e14])
def test_a_parameter_counts_in_any_unit_of_what_it_moves(unit):
    """Two modes beside each other, the gain of one and the pole of the other uncertain: both stay in the set."""
    plant = LinearPlant(A=((-1.0, 0.0), (0.0, -0.2)), B=((unit,), (1.0,)), C=((1.0 / unit, 1.0),))
    moves = plant.model().discretise(0.05)
    target = tracking_target("dc-motor")._replace(A=moves.A, B=moves.B, C=moves.C, of=plant)
    design = certified(problem_for(target), np.zeros((3, 2, 1, 1)), starts=(), evaluations=0)
    found = plants_between(target, design, [interval(plant, said) for said in ("B.0.0=1%", "A.1.1=0.15")])
    M, N = found.M / [[unit], [1.0]], np.hstack([found.N1 * [unit, 1.0], found.N2])
    changes = found.changes / [[unit], [1.0]] * [unit, 1.0, 1.0]
    delta = np.linalg.pinv(M) @ changes @ np.linalg.pinv(N)
    assert np.linalg.norm(delta, 2, axis=(-2, -1)).max() == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(M @ delta @ N, changes, atol=1e-9 * np.abs(changes).max())


def test_the_same_plant_in_other_units_bears_the_same_and_as_much_as_in_the_best_of_them(monkeypatch):
    """A cart behind a lag: covered in units in which the largest entries are alike, it bore 2.5, or 0.001, of the same errors."""
    monkeypatch.setitem(plant_uncertainty.GRID, 2, 5)
    A, B = np.array([[0.0, 1.0, 0.0], [0.0, -2.0, 1.0], [0.0, 0.0, -8.0]]), np.array([[0.0], [0.0], [8.0]])
    K, found = np.array([[[[-3.0]]]]), []
    for unit in np.array([[1.0, 1.0, 1.0], [1e-3, 1e-3, 1.0], [1.0, 1.0, 1e3]]):
        plant = LinearPlant(A=tuple(map(tuple, unit[:, None] * A / unit)), B=tuple(map(tuple, unit[:, None] * B)),
                            C=((1.0 / unit[0], 0.0, 0.0),))  # fmt: skip
        moves, one = plant.model().discretise(0.05), DelayChain(transition=((1.0,),))
        target = TrackingTarget("cart", 0.05, moves.A, moves.B, moves.C, one, one, plant)
        design = certified(problem_for(target, R=0.05), K, starts=(), evaluations=0)
        verdict = judge_uncertain(target, design, [interval(plant, said) for said in ("A.1.1=8%", "B.2.0=8%")])
        found.append([verdict.details[name] for name in ("margin", "h2_norm", "hinf_norm")])
    assert found[0][0] > 3.0
    np.testing.assert_allclose(found[1:], [found[0]] * 2, rtol=1e-4)


@pytest.mark.parametrize(
    ("plant", "names"),
    [
        (LinearPlant(A=((0.0, 1.0), (0.0, -2.0)), B=((0.0,), (170.0,)), C=((1.0, 0.0),)), ("B.1.0=10%", "A.1.1=0.5")),
        (TransferFunction(num=(170.0,), den=(1.0, 2.0, 0.0)), ("num.0=10%", "den.1=0.5")),
    ],
)
def test_entries_of_matrices_and_coefficients_are_parameters_of_a_plant(plant, names):
    motor = DCMotor(gain=170.0, pole=2.0)
    found = []
    for of, said in ((motor, ("gain=10%", "pole=0.5")), (plant, names)):
        moves = of.model().discretise(0.05)
        target = tracking_target("dc-motor")._replace(A=moves.A, B=moves.B, C=moves.C, of=of)
        found.append(plants_between(target, plain_design()[1], [interval(of, each) for each in said]))
    np.testing.assert_allclose(*(np.sort(each.changes, axis=0) for each in found), atol=1e-12)  # -pole falls as the pole rises
    with pytest.raises(HilError, match=r"--uncertainty: B\.2\.0: the plant has no such number"):
        interval(plant, "B.2.0=10%")
