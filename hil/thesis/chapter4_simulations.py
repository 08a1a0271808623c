"""Simulations of the example of Section 4.4, Figures 4.1 to 4.8, and the run that the text's own rule gives.

And gains of the corollaries themselves beside the printed ones, both under one bound.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from design.as_printed import (
    CHAPTER4_DETECTION_BOUNDARY_S,
    CHAPTER4_FAILURE_BOUNDARY_S,
    CHAPTER4_START,
    chapter4_gain,
    chapter4_partitioned_gain,
    chapter4_process,
    chapter4_seen_gain,
    chapter4_system,
)
from design.as_printed.chapters_2_to_4 import detection_section, free_gains
from design.controllers.scheduled_gain import ScheduledGain
from design.processes.further_rates import ColdStandbyRate, KOutOfNRate
from design.processes.partitions import Partition
from design.processes.rates import Rate
from design.processes.semi_markov import FaultDetection, sample_fault_detection
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.fault_tolerant import fault_tolerant_feedback
from hil.pages import Figure, Histogram, Series
from hil.thesis import Array, Plot, ReportProgress
from hil.thesis.noisy_runs import NoisyRuns, fault_runs
from hil.thesis.statements import ERRORS, above, below, exactly, number_of, run, says, statement

RUNS = 100
NOISE_S, OTHER_NOISE_S = 0.01, 0.1
PRINTED = {"(4.30)": "0.4606", "(4.31)": "0.3093"}
ASSUMED = "eta's rates linear over 0, 1, 2 s, r's over 0, 0.3, 0.6 s (no times are printed); a jump of eta leaves r's clock alone"
STATES = (("x1", "horizontal velocity", "knot"), ("x2 = y", "vertical velocity", "knot"), ("x3", "pitch rate", "deg/s"),
          ("x4", "pitch angle", "deg"))  # fmt: skip


def known_fault(gain: Array) -> ScheduledGain:
    """K_ik,m of shape (2, 2, sections, 2, 4) as a schedule over (eta, r) and r's clock."""
    sections = gain.reshape(4, -1, 2, 4)
    starts = np.array([[0.0, CHAPTER4_DETECTION_BOUNDARY_S][: sections.shape[1]]] * 4)
    return ScheduledGain(gain=sections, starts_s=starts, measured=("eta", "r"))


def our_gains() -> JumpCertificate:
    """Return gains that see r only, of norm 2 at most."""
    return fault_tolerant_feedback(chapter4_system(), faults(), gain_bound=2.0)


def faults() -> FaultDetection:
    """Return the failures and detections of the example, as `ASSUMED`."""
    return chapter4_process(failure_restarts_detection_clock=False)


def simulate(gain: ScheduledGain, runs: int | None = None, noise_s: float = NOISE_S) -> NoisyRuns:
    """Return runs of 3 s (`RUNS` by default) from the printed initial state, with the same faults and noise for every gain."""
    return fault_runs(
        chapter4_system(), gain, faults(), start=CHAPTER4_START, runs=runs or RUNS, duration_s=3.0, noise_s=noise_s, seed=4
    )


def lifetimes() -> Plot:
    """Figures 4.1 and 4.2: density and rate of redundant components, each with failure rate 1/s."""
    h = np.linspace(0.0, 5.0, 400)
    laws: dict[str, Rate] = {
        "one component": KOutOfNRate(needed=1, installed=1, rate=1.0),
        "one of two": KOutOfNRate(needed=1, installed=2, rate=1.0),
        "one of three": KOutOfNRate(needed=1, installed=3, rate=1.0),
        "one and a cold spare": ColdStandbyRate(installed=2, rate=1.0),
    }
    rates = tuple(Series(label=name, x=h, y=law(h)) for name, law in laws.items())
    densities = tuple(Series(label=name, x=h, y=law(h) * np.exp(-law.integral(h))) for name, law in laws.items())
    return Plot(
        title="Figures 4.1 and 4.2",
        intro="Only a single component has a constant rate. The failure rate of 1/s is an assumption; the axes are not printed.",
        panels=(
            Figure(title="4.1: density of the lifetime", x_label="lifetime", y_label="density", y_unit="1/s", series=densities,
                   sync=None),
            Figure(title="4.2: transition rate", x_label="sojourn time", y_label="rate", y_unit="1/s", series=rates, sync=None),
        ),
    )  # fmt: skip


def detection_fault(process: FaultDetection) -> Plot:
    """Figure 4.3: 19 s of the fault and what the detection says."""
    eta, r = sample_fault_detection(process, 0, 0, 19.0, np.random.default_rng(2))
    end = np.array([19.0])
    series = tuple(
        Series(label=name, x=np.append(path.times_s, end), y=np.append(path.modes, path.modes[-1]) + 1.0, style="step")
        for name, path in (("eta (fault)", eta), ("r (detection)", r))
    )
    panel = Figure(title="4.3: fault occurrence", y_label="mode", series=series, integer_y=True, sync=None)
    return Plot(title="Figure 4.3", panels=(panel,))


def _states(ensembles: dict[str, NoisyRuns], run: int | None) -> tuple[Figure, ...]:
    """Figures 4.4 to 4.7: a run of each controller, with the same jumps and noise, or without a number the average."""
    panels = []
    for n, (title, name, unit) in enumerate(STATES):
        series = tuple(
            Series(label=label, x=e.time_s, y=e.x[:, :, n].mean(axis=0) if run is None else e.x[run, :, n])
            for label, e in ensembles.items()
        )
        panels.append(Figure(title=title, y_label=name, y_unit=unit, series=series))
    return tuple(panels)


def ratios(ensembles: dict[str, NoisyRuns]) -> Plot:
    """Figure 4.8: ||y|| / ||w|| of every run."""
    series = tuple(
        Series(label=label, x=np.arange(1.0, e.ratio.size + 1), y=e.ratio, style="points") for label, e in ensembles.items()
    )
    panels: list[Figure | Histogram] = [
        Figure(title="4.8: ||y|| / ||w|| per run", x_label="run", x_unit="", y_label="ratio", series=series, sync=None)
    ]
    top = max(float(e.ratio.max()) for e in ensembles.values())
    for label, e in ensembles.items():
        counts, edges = np.histogram(e.ratio, bins=30, range=(0.0, top))
        panels.append(Histogram(title=label, edges=edges, counts=counts, x_label="||y|| / ||w||"))
    return Plot(title="Figure 4.8", panels=tuple(panels))


def text_rule(diverging: NoisyRuns, calm: NoisyRuns) -> Plot:
    """The printed gains used as K(r, h): (4.30) leaves, (4.31) stays."""
    panels = []
    for title, e in (("(4.30) as K_kk", diverging), ("(4.31) as K_kk,m", calm)):
        size = np.maximum(np.linalg.norm(e.x, axis=2), 1e-12)
        series = tuple(Series(label="single runs", x=e.time_s, y=size[k], colour=0, faint=True) for k in range(size.shape[0]))
        panels.append(Figure(title=title, y_label="|x|", y_log=True, series=series))
    return Plot(
        title="Gains that see r only", panels=tuple(panels),
        intro="(4.2) and (4.3) let the gain depend on the detection. With (4.30) an undetected fault grows by e^10.9 per second.",
    )  # fmt: skip


def early_figures(report_progress: ReportProgress) -> dict[str, Any]:
    """Figures 4.1 to 4.3."""
    return {"figures": (lifetimes(), detection_fault(faults()))}


def simulations(report_progress: ReportProgress) -> dict[str, Any]:
    """Runs of both controllers and of ours, with the same faults and noise."""
    gains = {name: known_fault(gain) for name, gain in zip(PRINTED, (chapter4_gain()[:, :, None], chapter4_partitioned_gain()))}
    ours = our_gains().gain
    runs = {}
    for n, (name, gain) in enumerate([*gains.items(), *([("ours, sees r, |K| <= 2", ours)] if ours is not None else [])]):
        report_progress(f"{RUNS} runs, {name}", n, len(gains) + 1)
        runs[name if n > 1 else f"{name}, fault known"] = simulate(gain)
    single, parts, *_ = runs.values()
    other = [simulate(gain, noise_s=OTHER_NOISE_S).ratio for gain in gains.values()]
    less = parts.ratio - single.ratio
    error = float(less.std()) / RUNS**0.5
    over = [float(np.abs(r.x[:, :, 1]).max(axis=1).mean()) - 1.0 for r in (single, parts)]
    return {
        "figures": (
            Plot(title="Figures 4.4 and 4.5", panels=_states(runs, 0), intro="One run of 3 s, same faults, detections, noise."),
            Plot(title="Figures 4.6 and 4.7", panels=_states(runs, None), intro=f"Averages of {RUNS} runs."),
            ratios(runs),
        ),
        "ratio": [[single.ratio, other[0]], [parts.ratio, other[1]]],
        "largest": [np.maximum(r.ratio, late).max() for r, late in zip((single, parts), other)],
        "less": less.mean(), "error": error, "surely": float(less.mean()) + 4.0 * error,
        "quotient": single.ratio.mean() / parts.ratio.mean(),
        "words": [
            "; ".join(f"{r.mean():.3f} +- {r.std():.3f} per run, largest {r.max():.3f}, noise held {t:g} s" for r, t in pair)
            for pair in (((kind.ratio, NOISE_S), (late, OTHER_NOISE_S)) for kind, late in zip((single, parts), other))
        ],
        "over": over, "half": 0.5 * over[0], "peak": [1 + each for each in over],
    }  # fmt: skip


def gains_that_see_r(report_progress: ReportProgress) -> dict[str, Any]:
    """The printed gains as the text prescribes their use: the controller sees the detection only."""
    runs = [simulate(chapter4_seen_gain(partitioned=parts), runs=20) for parts in (False, True)]
    return {"figures": (text_rule(*runs),)}


# fmt: off
BASIS = f"{RUNS} runs of 3 s, noise held {NOISE_S:g} s, fault known; {ASSUMED}"
SIMULATIONS = (
    *(
        statement(
            f"||y|| / ||w||, gains {name}, with noise whose sample time is not printed", ratio,
            *(
                run(f"share of the runs, noise held {held:g} s, below {ratio}", f"ratio[{n}][{k}]", ratio)
                for k, held in enumerate((NOISE_S, OTHER_NOISE_S))
            ),
            computed=f"{{words[{n}]}}", readings=True,
            basis=f"{RUNS} runs of 3 s, fault known; {ASSUMED}; the transient from x_2(0) = 1 dominates",
        )
        for n, (name, ratio) in enumerate(PRINTED.items())
    ),
    statement(
        "the ratio is below gamma = 1.5", "< 1.5",
        *(below(f"largest ratio, {name}", f"largest[{n}]", 1.5) for n, name in enumerate(PRINTED)),
        basis="one run's ratio bounds no gain: x(0) is not 0",
    ),
    statement(
        "the partition reduces ||y|| for the same w", "Remark 4.6",
        below("mean difference of the ratios plus 4 standard errors", "surely", 0),
        computed="quotient of the mean ratios {quotient:.3f}; difference {less:.4f} +- {error:.4f}",
        basis=f"{BASIS}; the printed ratios have the quotient {0.4606 / 0.3093:.3f} (ours, not printed)",
    ),
    statement(
        "overshoot of y is greatly reduced by the partition", "Figures 4.4 to 4.7",
        below("mean overshoot with (4.31)", "over[1]", "half"), computed="mean peak of |y| {peak[0]:.2f} and {peak[1]:.2f}",
        basis="|y(0)| = 1, so 1.00 means no overshoot at all; greatly: to less than half",
    ),
)
# fmt: on

GAMMA = 1.5
BOUNDS = (5.0, 10.0, 50.0)
"""Bounds on the norm of the gains; none is printed, and the largest norms of (4.30) and (4.31) are 51.6 and 34.9."""
ONE: Partition = ((0.0,),) * 2
ETA: Partition = ((0.0, CHAPTER4_FAILURE_BOUNDARY_S),) * 2
DETECTION: Partition = ((0.0, CHAPTER4_DETECTION_BOUNDARY_S),) * 2


def recomputed(report_progress: ReportProgress) -> dict[str, Any]:
    """Gains, levels and runs of both corollaries, for each bound of the gains."""
    values: dict[str, list[Any]] = {name: [] for name in ("single", "parts", "off", "levels", "less", "ratios", "share")}
    for n, bound in enumerate(BOUNDS):
        report_progress(f"gain norm <= {bound:g}", n, len(BOUNDS))
        single, parts = _sections(bound, GAMMA)
        gains = [_stacked([single]), _stacked(parts)]
        values["single"].append(single)
        values["parts"].append(parts)
        values["off"].append(
            [largest_entry(gains[0][:, :, 0] - chapter4_gain()), largest_entry(gains[1] - chapter4_partitioned_gain())]
        )
        least = _sections(bound, None)
        values["levels"].append([number_of(least[0].gamma), float(np.max([number_of(part.gamma) for part in least[1]]))])
        values["share"].append(values["levels"][-1][0] / values["levels"][-1][1])
        ratios = [simulate(known_fault(gain)).ratio for gain in gains]
        less = ratios[1] / ratios[0] - 1.0
        values["less"].append(float(less.mean()) + ERRORS * float(less.std()) / RUNS**0.5)
        values["ratios"].append([float(each.mean()) for each in ratios])
    return values | {"size": [float(np.abs(each).max()) for each in (chapter4_gain(), chapter4_partitioned_gain())]}


def _sections(bound: float, gamma: float | None) -> tuple[JumpCertificate, list[JumpCertificate]]:
    system, process = chapter4_system(), faults()
    single = detection_section(system, process, ONE, ONE, 0, None, gain_bound=bound, gamma=gamma)
    return single, [detection_section(system, process, ETA, DETECTION, m, None, gain_bound=bound, gamma=gamma) for m in (0, 1)]


def _stacked(sections: list[JumpCertificate]) -> Array:
    """K_ik,m, (2, 2, sections, 2, 4)."""
    gains = np.stack([free_gains(section, ("0,0", "0,1", "1,0", "1,1")) for section in sections], axis=1)
    return np.asarray(gains.reshape(2, 2, len(sections), 2, 4))


def largest_entry(difference: Array) -> float:
    return float(np.abs(difference).max())


# fmt: off
RECOMPUTED = (
    *(
        statement(
            f"{label}: the gains of {corollary} at gamma = 1.5", f"{count} matrices of 2 x 4",
            *(says(f"{equation}{which}, gains free", f"{name}[2]{at}.verdict", "certified") for which, at in sections),
            exactly("largest difference of the gains", f"off[2][{n}]", 0, 0.5e-4, f"size[{n}]"),
            basis=f"gain norm <= {BOUNDS[2]:g}; half a unit of the last printed digit. An inequality alone, with no objective "
            "and no bound printed: the printed gains fulfil it too (above)",
        )
        for n, (label, corollary, equation, count, name, sections) in enumerate((
            ("(4.30)", "Corollary 4.2", "(4.26)", "four", "single", (("", ""),)),
            ("(4.31)", "Corollary 4.3", "(4.27)", "eight", "parts", ((", section 1", "[0]"), (", section 2", "[1]"))),
        ))
    ),
    statement(
        "Remark 4.5: two sections (Corollary 4.3) are less conservative than one (Corollary 4.2), as printed",
        "extra constraints without sections",
        *(
            above(f"smallest gamma of Corollary 4.2 over that of Corollary 4.3, gain norm <= {bound:g}", f"share[{n}]", 1.01)
            for n, bound in enumerate(BOUNDS)
        ),
        computed="; ".join(f"{{levels[{n}][0]:.3g}} and {{levels[{n}][1]:.3g}}" for n in range(len(BOUNDS))), readings=True,
        basis="Corollary 4.3 tests two of four section pairs and is not sound (above): part of this may be what it leaves out",
    ),
    statement(
        "Remark 4.6: the partition reduces ||y||, with gains of both corollaries themselves under one bound", "reduced",
        *(
            below(f"mean change of ||y|| plus 4 standard errors, gain norm <= {bound:g}", f"less[{n}]", -0.001)
            for n, bound in enumerate(BOUNDS)
        ),
        computed="||y||/||w|| " + "; ".join(f"{{ratios[{n}][0]:.4f}} and {{ratios[{n}][1]:.4f}}" for n in range(len(BOUNDS))),
        readings=True,
        basis=f"gains at gamma = 1.5, {RUNS} runs of 3 s, fault known, noise held 0.01 s; by a thousandth",
    ),
)
# fmt: on
