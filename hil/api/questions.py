"""What a program asks without a run: gains for a plant, and what the network laws of an experiment do in the long run."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from design.controllers import check_row_sojourns
from design.tracking.design_file import design_text, to_document
from design.verdict import Verdict
from hil.api.experiment_source import Source, checked_arguments, checked_experiment
from hil.design_questions import TrackingTarget, problem_for, target_of, tracking_target, verdict_on
from hil.errors import HilError, located
from hil.experiment.tables import Experiment
from hil.files import check_output, write_output
from hil.log.write.provenance import package_versions
from hil.measure import Named
from hil.notebook import Cell, Result, SingleResult, data_frame
from hil.runtime.clock import monotonic_ns
from transport.law_tests.analysis import LawAnalysis, analyse_law

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from design.jump_linear.certificate import Certificate
    from design.networked_loop.certify import LowerBounds
    from design.tracking import TrackingProblem
    from design.tracking.synthesis import Design


LONGEST = 20
"""Ages beyond which a plot does not go."""


class Laws(SingleResult, Named[LawAnalysis]):
    """The law of every way, by its name: ``sc`` or each sensor node, and ``ca``; drawn as how often the newest packet is how old.

    Args:
        experiment: its name.
        found: what each law does.
        period_s: length T of a slot, s.
    """

    def __init__(self, experiment: str, found: Mapping[str, LawAnalysis], period_s: float) -> None:
        super().__init__("way", dict(found))
        self.experiment, self.period_s = experiment, period_s

    def to_pandas(self) -> pandas.DataFrame:
        """Return a row for every way and age: the share of slots in which the newest packet is that many slots old.

        Raises:
            HilError: if pandas is not installed.
        """
        rows = [(way, law.kind, age, share) for way, law in self.items() for age, share in enumerate(law.age_shares)]
        names = ("way", "law", "age", "share")
        columns = {name: [row[i] for row in rows] for i, name in enumerate(names)}
        return data_frame(columns, {"age": "slots", "share": "1"})

    def _paint(self, sheet: Figure) -> None:
        axis = sheet.subplots()
        width = 0.8 / len(self)
        for number, (way, law) in enumerate(self.items()):
            shares = law.age_shares[: LONGEST + 1]
            axis.bar(np.arange(len(shares)) + (number - (len(self) - 1) / 2) * width, shares, width, label=way)
        axis.set_xticks(range(min(max(len(law.age_shares) for law in self.values()), LONGEST + 1)))
        axis.set_xlabel("age of the newest packet (slots)")
        axis.set_ylabel("share of slots")
        axis.legend()

    def _result(self) -> Result:
        rows: list[list[Cell]] = [
            [way, law.kind, law.mean_age, 1e3 * law.mean_age * self.period_s, _known(law.mean_latency_s, 1e3),
             100 * law.loss_probability, _known(law.unused, 100)]
            for way, law in self.items()
        ]  # fmt: skip
        heads = ("way", "law", "mean age, slots", "mean age, ms", "mean latency, ms", "lost, %", "never used, %")
        return Result(line=repr(self)[1:-1], columns=heads, rows=rows, paint=self._paint)

    def __repr__(self) -> str:
        ways = ", ".join(f"{way} {law.kind} with mean age {law.mean_age:.3g} slots" for way, law in self.items())
        return f"<Laws of {self.experiment}: {ways}>"


def _known(value: float, scale: float) -> float | None:
    return None if math.isnan(value) else scale * value


@checked_arguments
def design(
    source: Source, *, period: float | None = None, sojourns: int = 1, row_sojourns: int = 1, **options: Any
) -> DesignResult:
    """Design gains for a plant over the network (7.34), or for the plant and network of an experiment.

    Args:
        source: name of a plant plug-in, or an experiment as in `run`; ``load_experiment("dc-motor-hinf", plant=Cart())`` is one.
        period: sample period in s; the thesis's, or the experiment's, by default.
        sojourns: slots for which tau has lasted that a gain distinguishes, over semi-Markov delays.
        row_sojourns: the same of d: a row for each d and so many slots that it has lasted, with ``information="applied"``.
        options: of `design.TrackingProblem`: objective ("h2", "hinf", "mixed"), information, R, samples, ...

    Returns:
        the design: ``gains``, ``certificate``, ``verdict``, ``problem``; ``save("gains.json")`` writes what an experiment takes.

    Raises:
        HilError: an option that does not fit, or no gains meet the request.
    """
    from design.errors import DesignError
    from design.requests.tracking import solve_tracking

    if sojourns < 1:
        raise HilError(f"design: sojourns: {sojourns}; expected a whole number of at least 1")
    with located("design", ValueError):
        check_row_sojourns(row_sojourns, options.get("information", "applied"), "information")
    sampled = None if period is None else float(period)
    if isinstance(source, Experiment):
        target = target_of(source, source.name, sampled, sojourns, row_sojourns)
    else:
        target = tracking_target(str(source), sampled, sojourns, row_sojourns)
    begun = monotonic_ns()
    with located("design", DesignError, TypeError):
        found = solve_tracking(problem_for(target, **options))
    return DesignResult(target=target, design=found, wall_s=round((monotonic_ns() - begun) / 1e9, 3))


@checked_arguments
def laws(source: Source, **changes: Any) -> Laws:
    """Return what an experiment's network laws do in the long run, before anything runs.

    Args:
        source: as in `run`.
        changes: path to value, as in `load_experiment`.

    Returns:
        "sc" or each sensor node, and "ca", to its stationary law, mean bursts, ages and losses (`LawAnalysis`).

    Raises:
        HilError: if the experiment cannot be read.
    """
    from hil.rig import rig_of
    from hil.rig.named_files import with_law_files

    checked = with_law_files(checked_experiment(source, None, None, changes))
    period_s = float(checked.period)
    rig = rig_of(checked)
    named = {sensor.name if len(rig.sensors) > 1 else "sc": (sensor.law, sensor.law_kind) for sensor in rig.sensors}
    deadline_s = checked.timing.deadline * period_s
    every = {**named, "ca": (rig.ca_law, rig.ca_kind)}.items()
    found = {name: analyse_law(law, period_s, deadline_s, kind) for name, (law, kind) in every}
    return Laws(checked.name, found, period_s)


@dataclass(frozen=True, kw_only=True, repr=False, eq=False)
class DesignResult(SingleResult):
    """A design with the plant and the network that it is for: its verdict, its file, and what a notebook shows of it.

    It is drawn as every gain over the label of tau.

    Args:
        target: plant and network.
        design: the gains and their certificate.
        wall_s: time that solving took, s.
    """

    target: TrackingTarget
    design: Design
    wall_s: float

    @property
    def gains(self) -> NDArray[np.float64]:
        """Gains (tau labels, rows, m, py), convention u = u* + K[tau, row] (y - r)."""
        return self.design.gains

    @property
    def certificate(self) -> Certificate:
        """What is computed from the gains: radius, norms, margins."""
        return self.design.certificate

    @property
    def problem(self) -> TrackingProblem:
        """What was asked."""
        return self.design.problem

    @property
    def bounds(self) -> LowerBounds | None:
        """Lower bounds for any causal controller, where they are known."""
        return self.design.bounds

    @cached_property
    def verdict(self) -> Verdict:
        """What the certifier says of the loop."""
        return verdict_on(self.target, self.design)

    def save(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the design file, which ``[controller] kind = "designed"`` takes by ``file =``; return its path.

        Args:
            path: the file.
            force: replace one that is there.

        Raises:
            HilError: it is there already, or cannot be written.
        """
        where = Path(path)
        check_output(where, "a design", ".json", force=force, remedy="choose another path, or add force=True")
        write_output(where, design_text(self.document()), replace=force)
        return where

    def document(self) -> dict[str, Any]:
        """Return what the design file says."""
        found = to_document(
            self.design, plant=self.target.plant, period_s=self.target.period_s, wall_s=self.wall_s, versions=package_versions()
        )
        return found | {"verdict": self.verdict.to_json()}

    def to_pandas(self) -> pandas.DataFrame:
        """Return a row per gain: label of tau, row of the packet, input, output, value.

        Raises:
            HilError: if pandas is not installed.
        """
        names = ("tau", "row", "input", "output")
        index = np.indices(self.gains.shape).reshape(len(names), -1)
        return data_frame({**dict(zip(names, index)), "gain": self.gains.ravel()})

    def _paint(self, sheet: Figure) -> None:
        axis = sheet.subplots()
        taus = np.arange(self.gains.shape[0])
        for index in np.ndindex(*self.gains.shape[1:]):
            row, inp, out = index
            label = f"row {row}" if self.gains[0, 0].size == 1 else f"row {row}, input {inp}, output {out}"
            axis.plot(taus, self.gains[(slice(None), *index)], marker="o", label=label)
        axis.set_xticks(taus)
        axis.set_xlabel("tau (samples)")
        axis.set_ylabel("gain")
        axis.legend()

    def _result(self) -> Result:
        c, bounds = self.certificate, self.bounds
        rows: list[list[Any]] = [
            ["H2 norm", c.h2_norm, None if bounds is None else bounds.h2_delayed_information],
            ["H-infinity norm", c.hinf_norm, None if bounds is None else bounds.hinf_delayed_information],
            ["second-moment radius", c.mean_square_radius, None],
        ]
        heads = ("quantity", "value", "no causal controller is below")
        return Result(
            line=repr(self)[1:-1], answer=[f"{self.verdict.state}: {self.verdict.reason}"], columns=heads, rows=rows,
            paint=self._paint,
        )  # fmt: skip

    def __repr__(self) -> str:
        c, problem = self.certificate, self.problem
        norm = c.hinf_norm if problem.objective == "hinf" else c.h2_norm
        name = "H-infinity" if problem.objective == "hinf" else "H2"
        norm_text = "" if norm is None else f", {name} norm {norm:.5g}"
        where = f"{self.target.plant} at {self.target.period_s * 1e3:g} ms"
        return f"<Design {problem.objective} for {where}, {problem.information}{norm_text}, {self.verdict.state}>"
