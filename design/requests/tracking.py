"""Controllers that an experiment asks for by what they shall achieve: a task, the solver, and the plug-ins that ask for it.

A request is solved, or its gains are read from a file, when the experiment is composed; what runs is the table of gains
(:class:`design.controllers.SendAll`). No process that keeps time solves anything.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import isqrt
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from msgspec import structs

from design.controllers import LoopModel, OutputFeedback, SendAll, check_row_sojourns, nested
from design.errors import FieldError, check_at_least_zero

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from design.controllers import LinearLaw
    from design.historical_data import DelayedPlant
    from design.processes.delay_chain import DelayChain
    from design.processes.semi_markov import FaultDetection, SemiMarkov
    from design.semi_markov_loop import DelayedJumpSystem, JumpSystem
    from design.tracking import TrackingProblem
    from design.tracking.design_file import DesignFile
    from design.tracking.synthesis import Design, Progress


@dataclass(frozen=True, slots=True, kw_only=True)
class DesignTask:
    """The loop for which gains are wanted.

    It is the loop that will run, as plain matrices, chains and rates.

    Args:
        model: the nominal plant at the sample period, and the largest delays.
        sc, ca: the delay chains of both directions; None where a law has none.
        jump_system: the modes of a plant that jumps, None of one that does not.
        jump_process: how its modes change.
        delayed_plant: the plant of Chapter 5, None of one that does not measure its state.
        initial_state: x(0) of that plant, shape (n,).
        folder: where relative file names begin.
        chainless: what keeps the network from having chains, in words; empty where nothing does.
    """

    model: LoopModel
    sc: DelayChain | None = None
    ca: DelayChain | None = None
    jump_system: JumpSystem | DelayedJumpSystem | None = None
    jump_process: SemiMarkov | FaultDetection | None = None
    delayed_plant: DelayedPlant | None = None
    initial_state: NDArray[np.float64] | None = None
    folder: str = "."
    chainless: str = ""

    @property
    def chains(self) -> tuple[DelayChain, DelayChain]:
        """The delay chains of both directions.

        Raises:
            FieldError: a law has none.
        """
        if self.sc is None or self.ca is None:
            raise FieldError("kind", f"a design needs a chain of ages on both links, but {self.chainless or 'a law states none'}")
        return self.sc, self.ca


def solve_tracking(problem: TrackingProblem, progress: Progress | None = None) -> Design:
    """Return the design that a problem asks for, by the method that it names: "direct", or "ccl" as printed.

    Args:
        problem: plant, network, information, objective.
        progress: called with the stage, the start, of how many, and the norm reached.

    Raises:
        DesignError: no gains meet the request.
    """
    if problem.method == "ccl":
        from design.as_printed.cone_complementarity import design_by_ccl

        return design_by_ccl(problem, progress=progress)
    from design.tracking.synthesis import solve

    return solve(problem, progress=progress)


@dataclass(frozen=True, slots=True, kw_only=True)
class Designed:
    """A tracking design of Chapter 7, for the loop that it will run in.

    Args:
        objective: ``h2`` (7.26), ``hinf`` (7.31) or ``mixed`` (7.33).
        information: what the gain may depend on: ``constant``, ``tau``, ``previous``, ``generated`` (printed), ``applied``,
            ``both``, ``total``.
        hinf_bound: mixed only: bound of the H-infinity norm.
        gain_bound: bound on every entry of every gain.
        input_weight: R of z = [Q x; R u1], Q = C.
        output_weights: weight of each output in Q x; by default 1.
        output: ``stacked`` or ``sum`` (as printed).
        integral: weight of the integrated error; above 0 the controller integrates (Remark 7.7).
        integral_limit: largest size of the sum of each output's errors, also of a file's gains, one entry per output;
            absent: no clamp.
        samples: samples per packet, 1 or 2: the newest, or also the one before.
        order: states of the controller's own, by which it remembers; what makes them depends on the measured delay as the gains
            do. 0: static gains.
        reference_weight: size of a step of the reference, in every output, that is weighed in the norm beside an impulse at every
            input; 0: none. Without it, a controller with a state takes a step for a disturbance, and answers hard.
        design_seed: seed of the multistart.
        sojourns: over semi-Markov delays: lengths of stay at the measured delay that the gain distinguishes, in slots; 1: none.
        row_sojourns: over semi-Markov delays: lengths of stay at d that the gain distinguishes, in slots; the packet has a row
            for each; needs ``information = "applied"``; 1: none.
        node_ages: several sensor nodes: the gain depends on the age of ``each`` node's newest sample, or on the ``oldest`` age.
        file: a design saved by ``hil design -o``, relative to the experiment: its gains run, and the problem beside them is
            the request, in the place of all the fields above; where it is another than the loop's, it is solved again.
    """

    objective: Literal["h2", "hinf", "mixed"] = "h2"
    information: Literal["constant", "tau", "previous", "generated", "applied", "both", "total"] = "applied"
    hinf_bound: float | None = None
    gain_bound: float | None = None
    input_weight: float = 0.01
    output: Literal["stacked", "sum"] = "stacked"
    integral: float = 0.0
    integral_limit: tuple[float, ...] = ()
    samples: Literal[1, 2] = 1
    order: int = 0
    reference_weight: float = 0.0
    design_seed: int = 0
    sojourns: int = 1
    row_sojourns: int = 1
    output_weights: tuple[float, ...] = ()
    node_ages: Literal["each", "oldest"] = "each"
    file: str = ""

    def __post_init__(self) -> None:
        check_at_least_zero(**{f"output_weights[{i}]": weight for i, weight in enumerate(self.output_weights)})
        if self.integral_limit and not (self.integral or self.file):
            raise FieldError("integral_limit", "needs integral above 0: without it there is no sum to clamp")
        if self.sojourns < 1:
            raise FieldError("sojourns", f"{self.sojourns}, expected at least 1")
        check_row_sojourns(self.row_sojourns, self.information, "information")

    @property
    def gains_given(self) -> bool:
        """Whether nothing is solved: a file has them."""
        return bool(self.file)

    def solve(self, task: DesignTask) -> SendAll:
        """Return the gains for a loop.

        Args:
            task: the loop; its chains are None where a law has none.

        Raises:
            FieldError: names the field.
        """
        model = task.model
        p, several = model.C.shape[0], len(model.nodes.names) > 1
        if self.output_weights and len(self.output_weights) != p:
            raise FieldError("output_weights", f"length {len(self.output_weights)}, expected {p}: one for each output")
        if self.integral and p > model.B.shape[1]:
            raise FieldError("integral", f"{model.B.shape[1]} inputs cannot make the mean errors of {p} outputs zero")
        if self.file:
            read = self._read(task)
            return self._as_filed(task, read, read.gains, read.state_gains, read.selection)
        sc, ca = task.chains
        ages: tuple[int, ...] = ()
        if several and self.sojourns > 1:
            raise FieldError("sojourns", "needs one sensor node; with several nodes the gain depends on their ages")
        if several and self.node_ages == "each":
            from design.processes.delay_chain import labels_of

            own = sc.output_ages(p)[:, [outputs[0] for outputs in model.nodes.outputs]].T
            ages = tuple((own.max(axis=1) + 1).tolist())
            sc = structs.replace(sc, labels=labels_of(own, ages))
        from design.tracking import state_gains_of
        from design.tracking.gain_cache import solve_cached
        from design.tracking.synthesis import TrackingProblem

        Q = np.array(self.output_weights)[:, None] * model.C if self.output_weights else None
        problem = TrackingProblem(
            A=model.A, B=model.B, C=model.C, sc=sc, ca=ca, objective=self.objective, information=self.information, Q=Q,
            R=self.input_weight, output=self.output, hinf_bound=self.hinf_bound, gain_bound=self.gain_bound,
            integral=self.integral, samples=self.samples, seed=self.design_seed, order=self.order,
            reference_weight=self.reference_weight,
        )  # fmt: skip
        rows, state_gains = state_gains_of(solve_cached(problem).gains, self.order)
        sojourns = sc.sojourns if self.sojourns > 1 else ()
        return _covering(task, SendAll(
            gains=nested(_rows(rows, ca, self.row_sojourns)), selection=problem.selection, integral=self.integral > 0,  # type: ignore[arg-type]
            sojourns=sojourns, samples=self.samples, state_gains=nested(state_gains) if self.order else (), ages=ages,
            row_sojourns=self.row_sojourns, integral_limit=self.integral_limit,
        ))  # fmt: skip

    def unfit(self, task: DesignTask) -> str:
        """Return in what the problem of the file differs from that of a loop; empty where it does not, or no chain states it.

        Args:
            task: the loop; its chains have the labels that the gains of the file tell apart.

        Raises:
            FieldError: the file does not state its problem.
        """
        from design.tracking.design_file import differs, problem_of

        problem = problem_of(self._read(task))
        return "" if task.sc is None or task.ca is None else differs(problem, task.model, task.sc, task.ca)

    def solve_again(self, task: DesignTask) -> SendAll:
        """Return gains that solve the request of the file for a loop.

        Args:
            task: the loop, as of `unfit`.

        Raises:
            FieldError: names the field.
            DesignError: no gains meet the request.
        """
        from design.tracking import state_gains_of
        from design.tracking.design_file import problem_of
        from design.tracking.gain_cache import solve_cached

        (sc, ca), model, read = task.chains, task.model, self._read(task)
        filed = problem_of(read)
        if read.document.get("robust"):
            what = self.unfit(task) or "its loop"
            raise FieldError("file", f"robust gains are for their own loop ({what}); design them with hil design --robust anew")
        design = solve_cached(replace(filed, A=model.A, B=model.B, C=model.C, sc=sc, ca=ca, initial=None))
        rows, own = state_gains_of(design.gains, filed.order)
        return self._as_filed(task, read, _rows(rows, ca, read.row_sojourns), own, design.selection)

    def _as_filed(
        self, task: DesignTask, read: DesignFile, gains: NDArray[np.float64], own: NDArray[np.float64], selection: str
    ) -> SendAll:
        return _covering(task, SendAll(
            gains=nested(gains), selection=selection, integral=read.integral, sojourns=read.sojourns,  # type: ignore[arg-type]
            samples=read.samples, row_sojourns=read.row_sojourns, integral_limit=self.integral_limit,
            state_gains=nested(own) if own.size else (),
        ))  # fmt: skip

    def _read(self, task: DesignTask) -> DesignFile:
        from design.tracking.design_file import load_design

        return load_design(Path(task.folder) / self.file)


def _rows(gains: NDArray[np.float64], ca: DelayChain, stays: int) -> NDArray[np.float64]:
    """Return the gains of a design with a row for every delay, and for how long it has lasted where they depend on that."""
    from design.tracking import with_every_row

    return np.asarray(gains) if stays == 1 else with_every_row(np.asarray(gains), ca, stays)


def _covering(task: DesignTask, found: SendAll) -> SendAll:
    """Return gains with a table and a row for every delay up to the loop's largest.

    A design has no row for a delay that its chains do not reach, such as one beyond a latency's bound; there it repeats the last.
    """
    model, sc, ca = task.model, task.sc, task.ca
    K = np.asarray(found.gains, dtype=float)
    per_delay, stays = found.selection != "constant", found.row_sojourns
    delays = isqrt(K.shape[1]) if found.selection == "both" else K.shape[1] // stays
    if sc is None or ca is None or (per_delay and delays <= ca.max_delay):  # too few rows for what comes: the loop refuses it
        return found
    more = max(0, model.d_max + 1 - delays) if per_delay else 0
    if found.selection == "both":
        pairs = K.reshape(len(K), delays, delays, *K.shape[2:])
        K = np.pad(pairs, [(0, 0), (0, more), (0, more), (0, 0), (0, 0)], mode="edge").reshape(len(K), -1, *K.shape[2:])
    elif more:
        K = np.pad(K, [(0, 0), (0, more * stays), (0, 0), (0, 0)], mode="edge")
    state_gains = found.state_gains
    if not found.sojourns and not found.ages and int(sc.label.max()) < len(K):
        tables = (0, max(0, model.tau_max + 1 - len(K)))
        K = np.pad(K, [tables, (0, 0), (0, 0), (0, 0)], mode="edge")
        state_gains += state_gains[-1:] * tables[1]
    return replace(found, gains=nested(K), state_gains=state_gains)


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalDesigned:
    """LQR, LQG or H-infinity for the plant alone; it ignores the network that it runs over, and is judged over it.

    It is what a networked design is compared with.

    Args:
        method: ``lqr``, ``lqg`` or ``hinf``, see `design.tracking.local_design`.
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
        from design.tracking.local_design import local_design

        return local_design(model.A, model.B, model.C, self.method, input_weight=self.input_weight, noise=self.noise)

    def solve(self, task: DesignTask) -> OutputFeedback:
        """Return the controller that runs.

        Args:
            task: the loop; its network is not looked at.
        """
        law = self.law(task.model)
        return OutputFeedback(A=nested(law.A), B=nested(law.B), C=nested(law.C), D=nested(law.D))
