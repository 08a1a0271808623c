"""Figures 2.2 to 2.4, and what the sound forms certify."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from design.monte_carlo.jump_loop import JumpLoop
from design.monte_carlo.studies import mean_states, trajectories
from hil.pages.html.figures import BarGroup, Bars, Figure, Histogram, Series
from hil.reproduce.chapter import Plot

FloatArray = npt.NDArray[np.float64]
DT_S = 0.01


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Settling:
    """Settling times (2.28) per run (s): of (2.27), of [1, 2], and of (2.27) from mode 2."""

    published: FloatArray
    reference: FloatArray
    published_from_mode_2: FloatArray


def _time(points: int) -> FloatArray:
    return np.asarray(np.arange(points) * DT_S)


def one_run(published: JumpLoop, reference: JumpLoop, seed: int = 3) -> Plot:
    """Figure 2.2: one run under the same switching, and 20 runs of (2.27)."""
    first = trajectories(published, 1, duration_s=10.0, dt_s=DT_S, seed=seed)[0]
    other = trajectories(reference, 1, duration_s=10.0, dt_s=DT_S, seed=seed)[0]
    many = trajectories(published, 20, duration_s=10.0, dt_s=DT_S, seed=seed)
    t = _time(first.shape[0])
    panels = [
        Figure(
            title=f"2.2a: x{n + 1}(t), same switching instants",
            y_label=f"x{n + 1}",
            series=(
                Series(label="(2.27)", x=t, y=first[:, n]),
                Series(label="[1, 2]", x=t, y=other[:, n], style="dashed"),
            ),
        )
        for n in (0, 1)
    ]
    panels += [
        Figure(
            title=f"2.2b: x{n + 1}(t), 20 runs of (2.27)",
            y_label=f"x{n + 1}",
            series=tuple(Series(label="single runs", x=t, y=many[k, :, n], colour=0, faint=True) for k in range(20)),
        )
        for n in (0, 1)
    ]
    return Plot(title="Figure 2.2", panels=tuple(panels), intro="One run of both controllers, and 20 semi-Markov paths.")


def monte_carlo_average(published: JumpLoop, reference: JumpLoop, settled: Settling, runs: int, seed: int) -> Plot:
    """Figure 2.3: average states, and the distribution of the settling time."""
    ours = mean_states(published, runs, duration_s=10.0, dt_s=DT_S, seed=seed)
    other = mean_states(reference, runs, duration_s=10.0, dt_s=DT_S, seed=seed)
    panels: list[Figure | Histogram] = [
        Figure(
            title=f"2.3a: mean of x{n + 1}, {runs} runs",
            y_label=f"E x{n + 1}",
            series=(
                Series(label="(2.27)", x=ours.time_s, y=ours.mean[:, n]),
                Series(label="[1, 2]", x=other.time_s, y=other.mean[:, n], style="dashed"),
            ),
        )
        for n in (0, 1)
    ]
    for name, values in (("(2.27)", settled.published), ("[1, 2]", settled.reference)):
        counts, edges = np.histogram(values[np.isfinite(values)], bins=60)
        panels.append(
            Histogram(title=f"2.3b: settling time of {name}", edges=edges, counts=counts, x_label="settling time", x_unit="s")
        )
    return Plot(title="Figure 2.3", panels=tuple(panels))


def convergence(settled: Settling) -> Plot:
    """Figure 2.4: mean and deviation of the settling time against the number of runs."""
    panels = []
    count = np.arange(1, settled.published.size + 1, dtype=float)
    for title, kind in (("2.4a: mean", "mean"), ("2.4b: standard deviation", "std")):
        series = []
        for name, values in (("(2.27)", settled.published), ("[1, 2]", settled.reference)):
            mean = np.cumsum(values) / count
            spread = np.sqrt(np.maximum(np.cumsum(values**2) / count - mean**2, 0.0))
            series.append(Series(label=name, x=count[9:], y=(mean if kind == "mean" else spread)[9:]))
        panels.append(
            Figure(
                title=f"{title} of the settling time",
                series=tuple(series),
                x_label="runs",
                x_unit="",
                x_log=True,
                y_label=kind,
                y_unit="s",
                sync=None,
            )
        )
    return Plot(title="Figure 2.4", panels=tuple(panels))


def certified_scales(scales: dict[tuple[str, int], float]) -> Plot:
    """What every method certifies, by the number of sections."""
    counts = (1, 2, 4, 8)
    names = {"pwl": "linear in h (ours)", "pwc": "constant per section (sound)", "printed": "printed (unsound)"}
    groups = tuple(
        BarGroup(label=names[m], values=[scales[m, n] for n in counts], hollow=m == "printed") for m in ("pwl", "pwc", "printed")
    )
    bars = Bars(
        title="largest certified scale of the uncertainty",
        categories=[f"M = {n}" for n in counts],
        groups=groups,
        x_label="sections",
        y_label="scale",
    )
    return Plot(
        title="What partitioning buys",
        panels=(bars,),
        intro="A_i(t), B_2(t) as printed, equal probability, |K| <= 100.",
    )
