"""Chapter 2: stability and robust control of semi-Markov jump linear systems; the example (2.25)-(2.28)."""

from __future__ import annotations

import numpy as np

from design.as_printed.examples import (
    CHAPTER2_BOUNDARY_S,
    CHAPTER2_START,
    chapter2_gain,
    chapter2_process,
    chapter2_reference_gain,
    chapter2_system,
)
from design.as_printed.robust_feedback import PrintedRequest
from design.as_printed.stability import printed_stability
from design.controllers.scheduled_gain import ScheduledGain
from design.errors import Infeasible
from design.lmi.exact import prove
from design.monte_carlo.jump_loop import JumpLoop
from design.monte_carlo.studies import settling_times
from design.processes.partitions import uniform
from design.processes.rates import PiecewiseLinearRate, WeibullRate, clip_rate, constant_rate
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop.certificate import JumpCertificate
from design.semi_markov_loop.robust_feedback import FeedbackRequest, Synthesis, largest_uncertainty, robust_feedback
from design.semi_markov_loop.second_moments import second_moment_decay, second_moment_radius
from design.semi_markov_loop.stability import analyse, largest_decay
from design.semi_markov_loop.system import JumpSystem
from hil.reproduce import Plot, Progress, Reproduction, Row, row
from hil.reproduce.chapter2.figures import Settling, certified_scales, convergence, monte_carlo_average, one_run

RUNS = 10_000
SEED = 1


def reproduce(progress: Progress) -> Reproduction:
    """Every number and figure of Section 2.5, and the theorems that do not hold."""
    rows: list[Row] = []
    for title, part in (
        ("feasibility claims", _feasibility),
        ("theorems", _theorems),
        ("exact second moments", _moments),
        ("rates and partition", _rates),
    ):
        progress(title)
        rows += part()
    progress(f"settling times, {RUNS} runs each")
    settled = _settling()
    rows += _settling_rows(settled)
    progress("certified scales")
    scales = _scales()
    rows.append(_scale_row(scales))
    progress("figures")
    figures: tuple[Plot, ...] = (
        one_run(_loop(chapter2_gain()), _loop(chapter2_reference_gain())),
        monte_carlo_average(_loop(chapter2_gain()), _loop(chapter2_reference_gain()), settled, RUNS, SEED),
        convergence(settled),
        certified_scales(scales),
    )
    return Reproduction(title="Chapter 2: semi-Markov jump linear systems", rows=tuple(rows), figures=figures)


def weibull_process() -> SemiMarkov:
    """The process of the published Monte Carlo runs: Weibull of scale 1 and shape 2, whose hazard is 2h."""
    rate = WeibullRate(scale_s=1.0, shape=2.0)
    return SemiMarkov(rates=((None, rate), (rate, None)))


def _loop(gain: ScheduledGain, mode: int = 0, process: SemiMarkov | None = None) -> JumpLoop:
    return JumpLoop(
        system=chapter2_system("printed"),
        gain=gain,
        process=process or weibull_process(),
        start=CHAPTER2_START,
        mode=mode,
        uncertain=True,
    )


def _verdict(certificate: JumpCertificate) -> str:
    margin = "" if certificate.margin is None else f", margin {certificate.margin:.3g}"
    return f"{certificate.verdict}{margin}"


def _refusal(system: JumpSystem, sections: int, method: str) -> str:
    try:
        robust_feedback(system, chapter2_process(), gain_bound=100.0, sections=sections, method=method)  # type: ignore[arg-type]
    except Infeasible as error:
        return str(error).rpartition(": ")[2]
    return "gains found"


def _feasibility() -> list[Row]:
    process, printed = chapter2_process(), chapter2_system("printed")
    single = robust_feedback(printed, process, gain_bound=30.0, sections=1, method="pwc")
    proof = prove(single)
    gains = (
        ", ".join(np.array2string(g[0, 0], precision=2) for g in single.gain.gain) if single.gain is not None else ""
    )
    published = printed_stability(printed, chapter2_gain(), process)
    constant = analyse(printed, chapter2_gain(), process, method="pwc", condition=1e3)
    linear = largest_decay(printed, chapter2_gain(), process, nodes=((0.0, CHAPTER2_BOUNDARY_S, 4.6),) * 2)
    ours = robust_feedback(
        chapter2_system("vertices"), process, gain_bound=100.0, sections=8
    )  # A_i(t), B_2(t) as printed
    return [
        row(
            "Theorem 2.4 (M = 1) for (2.25), rates in [0.1, 4.6]",
            "not feasible",
            f"feasible, K1, K2 = {gains}",
            "claim false",
            f"exact rational certificate: {proof.inequalities} inequalities, LDL' pivots >= {float(proof.smallest_pivot):.3g}",
        ),
        row(
            "the same with the F that give the printed A_i(t)",
            "not feasible",
            f"{_refusal(chapter2_system('matched'), 1, 'pwc')}; ours with 8 sections, linear in h: {ours.verdict}",
            "reproduced",
            "F_A1 = [0 .1; 0 0], F_A2 = [0 0; 0 .7]; (2.25) prints other F",
        ),
        row(
            "gains (2.27) fulfil the conditions of Corollary 2.2",
            "feasible, h_1 = 0.8326 s",
            f"printed form {_verdict(published)}; sound, constant per section: {_verdict(constant)}",
            "reproduced",
            "F of (2.25); the printed form proves nothing (below)",
        ),
        row(
            "gains (2.27) stabilise under all uncertainty of (2.25)",
            "stochastically stable",
            f"certified, E|x|^2 decays at {linear.decay_rate:.3g}/s or faster",
            "reproduced",
            "Lyapunov matrix linear in h, nodes 0, 0.8326, 4.6 s",
        ),
    ]


def _theorems() -> list[Row]:
    step = PiecewiseLinearRate(times_s=(0.0, 0.4967, 0.4967), values=(0.01, 0.01, 200.0))
    process = SemiMarkov(rates=((None, step), (step, None)))
    first = _autonomous([[-0.6, -1], [10, -0.6]], [[-0.6, -10], [1, -0.6]])
    second = _autonomous([[-0.7606, -0.2], [3.2, -0.7606]], [[-0.7606, -3.2], [0.2, -0.7606]])
    halves = ((0.0, 0.4967),) * 2
    nodes = uniform(chapter2_process(), 12)
    accepted = (
        printed_stability(first, None, process, nodes=halves),
        printed_stability(second, None, chapter2_process(), nodes=nodes),
    )
    refused = analyse(first, None, process, nodes=halves), analyse(second, None, chapter2_process(), nodes=nodes)
    exact = (
        analyse(first, None, process, method="exact"),
        analyse(second, None, chapter2_process(), method="exact"),
    )
    wide = PiecewiseLinearRate(times_s=(0.0, 1.0), values=(0.1, 10.0))
    back = constant_rate(3.0)
    three = _autonomous([[-0.05]], [[0.65]], [[-6.0]])
    box = SemiMarkov(rates=((None, wide, wide), (back, None, None), (back, None, None)))
    worst = SemiMarkov(rates=((None, constant_rate(10), constant_rate(0.1)), (back, None, None), (back, None, None)))
    ones = ((0.0,),) * 3
    corner = printed_stability(three, None, box, nodes=ones)
    growth = -(analyse(three, None, worst, method="exact").decay_rate or 0.0)
    rows = []
    for k, what in enumerate(
        ("hazard 0.01, then 200 from 0.4967 s", "the thesis's own rates (2.26), M = 12 uniform sections")
    ):
        rows.append(
            row(
                f"Corollary 2.1 is sufficient for stability ({what})",
                "stochastically stable",
                f"printed: {_verdict(accepted[k])}; ours: {refused[k].verdict}",
                "claim false",
                f"second moments grow by {exact[k].spectral_radius:.4g} per jump; jumps land in section 1, sections need a link",
            )
        )
    rows.append(
        row(
            "Theorem 2.2 covers the rate box for N = 3",
            "stochastically stable",
            f"printed: {_verdict(corner)}; ours: {analyse(three, None, box, method='pwc', nodes=ones).verdict}",
            "claim false",
            f"at rates (10, 0.1) E|x|^2 grows like e^({growth:.3g} t); two corners span a segment only",
        )
    )
    rows.append(
        row(
            "a larger M is more likely to be feasible",
            "Section 2.5",
            "true of the sound forms (Figure: certified scale)",
            "reproduced",
            "of the printed form partly because more sections make it less sound",
        )
    )
    return rows


def _autonomous(*modes: list[list[float]]) -> JumpSystem:
    a = np.array(modes, dtype=float)
    return JumpSystem(a=a, b=np.zeros((*a.shape[:2], 1)))


def _moments() -> list[Row]:
    process, nominal = chapter2_process(), chapter2_system("none")
    corner = chapter2_system("vertices").at_vertex(1)
    corner = JumpSystem(
        a=np.stack([nominal.a[0], corner.a[1]]), b=np.stack([nominal.b[0], corner.b[1]])
    )  # sigma = 0, rho = 1
    rows = []
    for name, gain, claim in (("(2.27)", chapter2_gain(), ""), ("[1, 2]", chapter2_reference_gain(), "")):
        radius, decay = second_moment_radius(nominal, gain, process), second_moment_decay(nominal, gain, process)
        edge = second_moment_radius(corner, gain, process)
        stable = edge < 1.0
        rows.append(
            row(
                f"gains {name} stabilise the example{claim}",
                "stochastically stable",
                f"nominal: radius {radius:.5f} per jump, |x| decays at {decay / 2:.4f}/s; rho = +1: radius {edge:.4g}",
                "reproduced" if stable else "claim false",
                "exact second moments, A_i(t) as printed"
                if stable
                else "unstable for A_2(t), B_2(t) as printed at rho = +1",
            )
        )
    return rows


def _rates() -> list[Row]:
    h, twice = np.array([0.1, 4.6]), weibull_process()
    plain = float(np.exp(-0.5 * h[0] ** 2) - np.exp(-0.5 * h[1] ** 2))
    doubled = float(np.exp(-(h[0] ** 2)) - np.exp(-(h[1] ** 2)))
    ramp = SemiMarkov(rates=((None, clip_rate(0.1, 4.6)), (clip_rate(0.1, 4.6), None)))
    median = [float(p.sojourn(0, np.array(np.log(2.0)))) for p in (twice, ramp)]
    return [
        row(
            "Weibull, scale 1 and shape 2, has the rate h",
            "lambda(h) = h",
            "lambda(h) = 2h",
            "claim false",
            "f/(1 - F) = 2h exp(-h^2)/exp(-h^2)",
        ),
        row(
            "Pr{0.1 <= h <= 4.6}",
            "> 0.99",
            f"{plain:.4f} (rate h), {doubled:.5f} (rate 2h)",
            "reproduced",
        ),
        row(
            "h = 0.8326 halves the probability (2.22)",
            "0.8326 s",
            f"{median[0]:.4f} s for the rate 2h, {median[1]:.4f} s for (2.26)",
            "reproduced",
            "the median of the Weibull law (rate 2h), not of the printed rate (2.26)",
        ),
    ]


def _settling() -> Settling:
    ours = settling_times(_loop(chapter2_gain()), RUNS, duration_s=20.0, seed=SEED)
    other = settling_times(_loop(chapter2_reference_gain()), RUNS, duration_s=40.0, seed=SEED)
    second = settling_times(_loop(chapter2_gain(), mode=1), RUNS, duration_s=20.0, seed=SEED)
    return Settling(published=ours, reference=other, published_from_mode_2=second)


def _settling_rows(settled: Settling) -> list[Row]:
    basis = "rate 2h, F of (2.25), sigma and rho constant per run and uniform in [-1, 1], 10,000 runs"
    others = ", ".join(
        f"{name}: {times.mean():.2f} s, {times.std():.2f} s"
        for name, times in (
            (
                "printed rate (2.26)",
                settling_times(_loop(chapter2_gain(), process=chapter2_process()), RUNS, duration_s=20.0, seed=SEED),
            ),
            ("r_0 = 2", settled.published_from_mode_2),
            ("h_1 moved to 0.2 s", settling_times(_loop(chapter2_gain(0.2)), RUNS, duration_s=20.0, seed=SEED)),
        )
    )
    clipped = settling_times(
        _loop(chapter2_reference_gain(), process=chapter2_process()), RUNS, duration_s=40.0, seed=SEED
    )
    rows = [
        row(
            "settling time (2.28) of (2.27), mean and deviation",
            "3.5741 s, 0.8849 s",
            f"{settled.published.mean():.3f} s, {settled.published.std():.3f} s",
            "not reproduced",
            f"{basis}; {others}",
        ),
        row(
            "settling time (2.28) of [1, 2], mean and deviation",
            "9.9100 s, 2.1895 s",
            f"{settled.reference.mean():.3f} s, {settled.reference.std():.3f} s",
            "reproduced",
            f"{basis}; with the printed rate (2.26): {clipped.mean():.2f} s, {clipped.std():.2f} s",
        ),
    ]
    start = settled.published_from_mode_2
    quantiles = np.quantile(np.abs(start - start.mean()), [0.6827, 0.9545, 0.9973])
    for k, printed in enumerate(("0.87", "1.75", "3.03")):
        rows.append(
            row(
                f"Table 2.1, +-{k + 1} standard deviation",
                f"{printed} s",
                f"{quantiles[k]:.2f} s",
                "reproduced",
                "read as quantiles (68.27, 95.45, 99.73 %) of |T_s - mean|, r_0 = 2; they are not multiples of 0.8849",
            )
        )
    return rows


def _scales() -> dict[tuple[str, int], float]:
    out = {}
    for method in ("printed", "pwc", "pwl"):
        for sections in (1, 2, 4, 8):
            request: Synthesis = PrintedRequest(process=chapter2_process(), gain_bound=100.0, sections=sections)
            if method != "printed":
                request = FeedbackRequest(process=chapter2_process(), gain_bound=100.0, sections=sections, method=method)
            out[method, sections] = largest_uncertainty(chapter2_system("vertices"), request, tolerance=2e-3)[0]
    return out


def _scale_row(scales: dict[tuple[str, int], float]) -> Row:
    def line(method: str) -> str:
        return ", ".join(f"{scales[method, m]:.2f}" for m in (1, 2, 4, 8))

    return row(
        "partitioning reduces conservativeness: largest scale of the uncertainty, M = 1, 2, 4, 8",
        "Section 2.4",
        f"ours, linear in h: {line('pwl')}; sound, constant per section: {line('pwc')}; printed (unsound): {line('printed')}",
        "reproduced",
        "A_i(t), B_2(t) as printed, equal probability (2.22), |K| <= 100; the form matters more than M",
    )
