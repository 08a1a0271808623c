"""Figures 4.1 to 4.8, and the run that the text's own rule gives."""

from __future__ import annotations

import numpy as np

from design.processes.lifetimes import ColdStandbyRate, KOutOfNRate
from design.processes.semi_markov import FaultDetection, sample_fault_detection
from hil.pages.html.figures import Figure, Histogram, Series
from hil.thesis.chapter import Plot
from hil.thesis.noisy_runs import NoisyRuns

STATES = (("x1", "horizontal velocity", "knot"), ("x2 = y", "vertical velocity", "knot"), ("x3", "pitch rate", "deg/s"),
          ("x4", "pitch angle", "deg"))  # fmt: skip


def lifetimes() -> Plot:
    """Figures 4.1 and 4.2: density and rate of redundant components, each with failure rate 1/s."""
    h = np.linspace(0.0, 5.0, 400)
    laws: dict[str, KOutOfNRate | ColdStandbyRate] = {
        "one component": KOutOfNRate(needed=1, installed=1, rate=1.0),
        "one of two": KOutOfNRate(needed=1, installed=2, rate=1.0),
        "one of three": KOutOfNRate(needed=1, installed=3, rate=1.0),
        "one and a cold spare": ColdStandbyRate(installed=2, rate=1.0),
    }
    rates = tuple(Series(label=name, x=h, y=law(h)) for name, law in laws.items())
    densities = tuple(Series(label=name, x=h, y=law(h) * law.reliability(h)) for name, law in laws.items())
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


def single_runs(ensembles: dict[str, NoisyRuns]) -> Plot:
    """Figures 4.4 and 4.5: one run of each controller, same jumps and noise."""
    return Plot(
        title="Figures 4.4 and 4.5",
        panels=_states(ensembles, 0),
        intro="One run of 3 s, same faults, detections and noise.",
    )


def averages(ensembles: dict[str, NoisyRuns]) -> Plot:
    """Figures 4.6 and 4.7: average trajectories."""
    count = min(e.x.shape[0] for e in ensembles.values())
    return Plot(title="Figures 4.6 and 4.7", panels=_states(ensembles, None), intro=f"Averages of {count} runs.")


def _states(ensembles: dict[str, NoisyRuns], run: int | None) -> tuple[Figure, ...]:
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
