"""Runs of Chapters 3 and 4 beside what is known of them: delays by small steps, growth by mode, and the noise that they had."""

from __future__ import annotations

from collections import Counter
from itertools import groupby, pairwise

import numpy as np
import pytest

from design.controllers.scheduled_gain import ScheduledGain, constant_gain
from design.processes.rates import constant_rate
from design.processes.semi_markov import FaultDetection, SemiMarkov, sample_fault_detection
from design.semi_markov_loop import DelayedJumpSystem, JumpSystem
from hil.thesis.noisy_runs import delayed_runs, fault_runs

ONE = SemiMarkov(rates=((None,),))
TWO = SemiMarkov(rates=((None, constant_rate(1.0)), (constant_rate(1.5), None)))
STARTS = np.array([[0.0, 0.5], [0.0, 0.5]])
GROWTH = np.array([[-1.0, -2.0], [-3.0, -4.0]]).reshape(2, 2, 1, 1)


def delayed(a: object, ad: object, e: object = 0.0, *, slope: float = 0.0, modes: int = 1) -> DelayedJumpSystem:
    """A system with a delay of 0.8 s at most, alike in all modes."""
    n = len(np.atleast_2d(a))
    made = [np.broadcast_to(np.atleast_2d(each).astype(float), (modes, n, n)) for each in (a, ad, e)]
    return DelayedJumpSystem(
        a=made[0], ad=made[1], b=np.eye(n, 1)[None].repeat(modes, 0), e=made[2], c=np.eye(n)[None].repeat(modes, 0),
        delay_max_s=0.8, delay_slopes=np.full(modes, slope),
    )  # fmt: skip


@pytest.mark.parametrize("slope", [0.0, 0.9])
def test_a_run_follows_its_delay_from_a_past_that_stood_still(slope: float) -> None:
    """Beside Heun's method in steps of 1 ms; a delay that grows by 0.9 at most falls to 0 at its least."""
    a, ad, k = np.array([[-0.5, 1.0], [-1.0, 0.2]]), np.array([[-1.0, 0.3], [0.0, -0.8]]), np.array([[-0.4, 0.1]])
    gain = ScheduledGain(gain=k[None, None], starts_s=np.zeros((1, 1)))
    found = delayed_runs(
        delayed(a, ad, slope=slope), gain, ONE, start=(1.0, -2.0), runs=2, duration_s=4.0, noise_s=0.1, noise=False
    )  # fmt: skip
    step, closed = 1e-3, a + np.eye(2, 1) @ k
    times = np.arange(-1000, 4001) * step
    x = np.tile([1.0, -2.0], (len(times), 1))

    def flow(n: int, t: float, y: np.ndarray) -> np.ndarray:
        ago = t - 0.4 * (np.sin(2.0 * slope * t / 0.8) + 1.0)
        past = [np.interp(ago, times[: n + 1], x[: n + 1, i]) if ago <= times[n] else y[i] for i in range(2)]
        return np.asarray(closed @ y + ad @ past)

    for n in range(1000, 5000):
        one = flow(n, times[n], x[n])
        x[n + 1] = x[n] + step * one
        x[n + 1] = x[n] + 0.5 * step * (one + flow(n + 1, times[n + 1], x[n + 1]))
    assert found.time_s == pytest.approx(np.arange(1001) * 4e-3)
    for run in found.x:
        assert np.abs(run - x[1000::4]).max() < 2e-3
    assert np.isinf(found.ratio).all() and found.size == pytest.approx(
        [np.sqrt(np.trapezoid((x[1000:] ** 2).sum(axis=1), dx=step))] * 2, rel=1e-3
    )  # fmt: skip


def test_every_stretch_of_a_delayed_run_grows_as_its_mode_and_section_do() -> None:
    gain = ScheduledGain(gain=GROWTH, starts_s=STARTS)
    found = delayed_runs(
        delayed(0.0, 0.0, modes=2), gain, TWO, start=(1.0,), runs=60, duration_s=4.0, noise_s=1.0, noise=False, seed=3
    )  # fmt: skip
    seen, first, lasts = Counter[tuple[int, int]](), [], list[int]()
    for x in found.x[:, :, 0]:
        rates = np.round(np.diff(np.log(x)) / 4e-3).astype(int).tolist()
        stretches = [(rate, len(list(group))) for rate, group in groupby(rates)]
        assert stretches[0][0] == -1 and abs(np.diff(np.log(x)) / 4e-3 - rates).max() < 1e-6
        seen.update((one[0], other[0]) for one, other in pairwise(stretches))
        lasts += [steps for (rate, steps), (then, _) in pairwise(stretches) if then == rate - 1 and rate % 2]
        first.append(next((n for n, rate in enumerate(rates) if rate < -2), 1000) * 4e-3)
    usual = {each for each, times in seen.items() if times > 5}  # a jump and one back may come within a step
    assert usual == {(-1, -2), (-1, -3), (-2, -3), (-3, -4), (-3, -1), (-4, -1)}
    assert set(sorted(lasts)[:-5]) == {125} and len(lasts) > 100
    assert abs(np.mean(first) - (1.0 - np.exp(-4.0))) < 5.0 / np.sqrt(60)


def test_noise_is_held_for_its_time_and_drives_every_channel_of_every_run() -> None:
    """x' = -x + e w: what w was is read from both ends of a step; w is N(0, 1) and the same for as long as it is held."""
    e = np.array([[2.0, 0.0], [1.0, 1.0]])
    found = delayed_runs(
        delayed(-np.eye(2), np.zeros((2, 2)), e), constant_gain(np.zeros((1, 1, 2))), ONE, start=(0.0, 0.0), runs=40,
        duration_s=2.0, noise_s=0.02, seed=1,
    )  # fmt: skip
    share = np.exp(-4e-3)
    w = (found.x[:, 1:] - share * found.x[:, :-1]) / (1.0 - share) @ np.linalg.inv(e).T
    w = w.reshape(40, 100, 5, 2)
    assert np.ptp(w, axis=2).max() < 1e-6
    held = w[:, :, 0]
    assert abs(held.mean()) < 5.0 / np.sqrt(held.size) and abs((held**2).mean() - 1.0) < 5.0 * np.sqrt(2.0 / held.size)
    assert abs(np.corrcoef(held.reshape(-1, 2).T)[0, 1]) < 5.0 / np.sqrt(4000) and not np.allclose(held[0], held[1])
    assert found.size / found.ratio == pytest.approx(np.sqrt((held**2).sum(axis=(1, 2)) * 0.02), rel=1e-6)


@pytest.mark.parametrize(("measured", "restarts"), [(("r",), True), (("r",), False), (("eta", "r"), False)])
def test_a_run_with_faults_grows_by_what_failed_and_by_what_was_seen_of_it(measured: tuple[str, ...], restarts: bool) -> None:
    """log x(t) is the integral of b[eta] k[what is measured, section of its clock], by small steps of the path itself."""
    process = FaultDetection(failure=TWO, detection=(TWO, TWO), failure_restarts_detection_clock=restarts)
    rows = len(measured) * 2
    k = -np.arange(1.0, 2 * rows + 1.0).reshape(rows, 2, 1, 1) / 4.0
    gain = ScheduledGain(gain=k, starts_s=np.tile([0.0, 0.35], (rows, 1)), measured=measured)
    system = JumpSystem(a=np.zeros((2, 1, 1)), b=np.array([[[1.0]], [[0.4]]]), c=np.ones((2, 1, 1)), e=np.zeros((2, 1, 1)))
    found = fault_runs(system, gain, process, start=(3.0,), runs=6, duration_s=3.0, noise_s=0.05, seed=7)
    assert found.x.shape == (6, 61, 1) and found.time_s == pytest.approx(np.arange(61) * 0.05) and (found.x[:, 0] == 3.0).all()
    fine = np.arange(0.0, 3.0, 1e-4) + 5e-5
    for run, x in enumerate(found.x[:, :, 0]):
        eta, r = sample_fault_detection(process, 0, 0, 3.0, np.random.default_rng([7, run]))
        failed, (seen, clock) = eta.at(fine)[0], r.at(fine)
        row = seen if measured == ("r",) else 2 * failed + seen
        growth = system.b[failed, 0, 0] * k[row, (clock >= 0.35).astype(int), 0, 0]
        assert np.log(x[1:] / 3.0) == pytest.approx(np.cumsum(growth * 1e-4)[499::500], abs=2e-3)
    assert len({*found.x[:, -1, 0]}) == 6


def test_noise_of_a_run_with_faults_is_that_of_its_seed_whatever_the_gain() -> None:
    """One mode, x' = (a + k) x + e w: w is read from both ends of a step."""
    process = FaultDetection(failure=ONE, detection=(ONE,), failure_restarts_detection_clock=False)
    system = JumpSystem(a=-np.eye(2)[None], b=np.eye(2, 1)[None], c=np.array([[[0.0, 3.0]]]), e=np.array([[[1.0], [2.0]]]))
    runs = [
        fault_runs(system, constant_gain(gain), process, start=(0.0, 0.0), runs=20, duration_s=5.0, noise_s=0.05)
        for gain in (np.zeros((1, 1, 2)), np.array([[[-1.0, 0.0]]]))
    ]
    share = np.exp(-0.05)
    noise = [(run.x[:, 1:, 1] - share * run.x[:, :-1, 1]) / (1.0 - share) / 2.0 for run in runs]
    assert noise[0] == pytest.approx(noise[1]) and len({*noise[0][:, 0]}) == 20
    assert abs(noise[0].mean()) < 5.0 / np.sqrt(2000) and abs((noise[0] ** 2).mean() - 1.0) < 5.0 * np.sqrt(2.0 / 2000)
    assert not np.allclose(runs[0].x[:, -1, 0], runs[1].x[:, -1, 0])
    for run in runs:
        assert run.size == pytest.approx(np.sqrt(np.trapezoid(9.0 * run.x[:, :, 1] ** 2, dx=0.05, axis=1)))
        assert run.ratio == pytest.approx(run.size / np.sqrt((noise[0] ** 2).sum(axis=1) * 0.05))
