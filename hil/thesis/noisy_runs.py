"""Runs of the VTOL examples under sampled white noise, for the norm ratios and the trajectories of Chapters 3 and 4.

The thesis prints neither the sample time of the noise nor the length of the Chapter 3 run nor when the rates take which value,
so all of them are arguments. Noise: independent N(0, 1) per channel, held over ``noise_s``.
"""

from __future__ import annotations

import math
from functools import cache, partial
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm

from design.controllers.scheduled_gain import ScheduledGain
from design.processes.semi_markov import FaultDetection, SemiMarkov, sample_fault_detection, sample_path
from design.semi_markov_loop import DelayedJumpSystem, JumpSystem
from design.semi_markov_loop.period_moments import gain_mode
from hil.thesis import Array


class NoisyRuns(NamedTuple):
    """``time_s`` (G,), ``x`` (runs, G, n), ``ratio`` ||z|| / ||w|| per run, and ``size`` = sqrt(int |z|^2) per run."""

    time_s: Array
    x: Array
    ratio: Array
    size: Array


def _norms(time_s: Array, x: Array, c: Array, noise: Array, noise_s: float) -> tuple[Array, Array]:
    z = x @ c.T
    size = np.sqrt(np.trapezoid((z * z).sum(axis=-1), time_s, axis=-1))
    with np.errstate(divide="ignore"):
        return size / np.sqrt((noise * noise).sum(axis=(1, 2)) * noise_s), size


def delayed_runs(
    system: DelayedJumpSystem,
    gain: ScheduledGain,
    process: SemiMarkov,
    *,
    start: tuple[float, ...],
    runs: int,
    duration_s: float,
    noise_s: float,
    noise: bool = True,
    step_s: float = 4e-3,
    seed: int = 0,
) -> NoisyRuns:
    """Runs with the delay (3.43), x(t) = x(0) for t < 0, by fourth-order Runge-Kutta over all runs at once.

    The delayed state is interpolated linearly; jumps are moved to the next step. Mode 0 at t = 0.
    """
    steps = round(duration_s / step_s)
    rng = np.random.default_rng(seed)
    time_s: Array = np.asarray(np.arange(steps + 1) * step_s)
    paths = [sample_path(process, 0, duration_s + step_s, rng) for _ in range(runs)]
    at = [path.at(time_s) for path in paths]
    modes, clocks = np.stack([mode for mode, _ in at], axis=1), np.stack([h for _, h in at], axis=1)
    held = rng.standard_normal((runs, math.ceil(duration_s / noise_s), system.e.shape[2])) * float(noise)
    tau_max, slopes = system.delay_max_s, system.delay_slopes
    x = np.empty((steps + 1, runs, len(start)))
    x[0] = start
    every = np.arange(runs)

    def delayed(k: int, t: float, now: Array, mode: npt.NDArray[np.intp]) -> Array:
        tau = 0.5 * tau_max * (np.sin(2.0 * slopes[mode] * t / tau_max) + 1.0)
        position = np.maximum((t - tau) / step_s, 0.0)
        low = np.minimum(position.astype(np.intp), k)
        high = np.minimum(low + 1, k)
        part = np.minimum(position - low, 1.0)[:, None]
        later = np.where((low < k)[:, None], x[high, every], now)
        span = np.where(low < k, 1.0, max((t - k * step_s) / step_s, 1e-12))[:, None]
        return np.asarray(x[low, every] + np.minimum(part / span, 1.0) * (later - x[low, every]))

    for k in range(steps):
        mode, t = modes[k], k * step_s
        section = np.minimum((clocks[k][:, None] >= gain.starts_s[mode]).sum(axis=1), gain.starts_s.shape[1]) - 1
        loop = system.a[mode] + system.b[mode] @ gain.gain[mode, section]
        ad = system.ad[mode]
        push = np.einsum("rij,rj->ri", system.e[mode], held[:, min(int(t / noise_s + 1e-9), held.shape[1] - 1)])

        def flow(
            t: float, y: Array, k: int = k, mode: npt.NDArray[np.intp] = mode, loop: Array = loop, ad: Array = ad,
            push: Array = push,
        ) -> Array:  # fmt: skip
            return np.asarray(np.einsum("rij,rj->ri", loop, y) + np.einsum("rij,rj->ri", ad, delayed(k, t, y, mode)) + push)

        one = flow(t, x[k])
        two = flow(t + 0.5 * step_s, x[k] + 0.5 * step_s * one)
        three = flow(t + 0.5 * step_s, x[k] + 0.5 * step_s * two)
        four = flow(t + step_s, x[k] + step_s * three)
        x[k + 1] = x[k] + step_s / 6.0 * (one + 2.0 * two + 2.0 * three + four)
    out = np.moveaxis(x, 0, 1)
    ratio, size = _norms(time_s, out, system.c[0], held, noise_s)
    return NoisyRuns(time_s, out, ratio, size)


def fault_runs(
    system: JumpSystem,
    gain: ScheduledGain,
    process: FaultDetection,
    *,
    start: tuple[float, ...],
    runs: int,
    duration_s: float,
    noise_s: float,
    seed: int = 0,
) -> NoisyRuns:
    """Runs with failures and detections, exact between noise samples and jumps; eta = r = 0 and all clocks 0 at t = 0.

    A seed gives the same jumps and the same noise to every gain.
    """
    assert system.c is not None and system.e is not None
    count = round(duration_s / noise_s)
    time_s: Array = np.asarray(np.arange(count + 1) * noise_s)
    x, held = np.empty((runs, count + 1, len(start))), np.empty((runs, count, system.e.shape[2]))
    step = cache(partial(_held, system, gain))
    for run in range(runs):
        rng = np.random.default_rng([seed, run])
        eta, r = sample_fault_detection(process, 0, 0, duration_s, rng)
        held[run] = rng.standard_normal(held.shape[1:])
        sections = np.add.outer(r.times_s, np.unique(gain.starts_s)).ravel()
        edges = np.unique(np.concatenate([time_s, eta.times_s, sections[sections < time_s[-1]]]))
        noise_at = np.searchsorted(time_s, edges[:-1], side="right") - 1
        failed, (seen, clocks) = eta.at(edges[:-1])[0].tolist(), r.at(edges[:-1])
        x[run, 0] = state = np.asarray(start)
        stretches = zip(noise_at.tolist(), failed, seen.tolist(), clocks, np.diff(edges).tolist(), strict=True)
        for k, i, detected, clock, span in stretches:
            mode = gain_mode(gain.measured, process, i, detected)
            section = int(np.searchsorted(gain.starts_s[mode], clock + 1e-12, side="right")) - 1
            transition, drive = step(i, mode, section, round(span, 12))
            x[run, k + 1] = state = transition @ state + drive @ held[run, k]
    ratio, size = _norms(time_s, x, system.c[0], held, noise_s)
    return NoisyRuns(time_s, x, ratio, size)


def _held(
    system: JumpSystem, gain: ScheduledGain, i: int, mode: int, section: int, step_s: float
) -> tuple[Array, Array]:
    """Transition and input matrix over a step with the noise held."""
    assert system.e is not None
    loop, e = system.a[i] + system.b[i] @ gain.gain[mode, section], system.e[i]
    n, q = e.shape
    block = np.zeros((n + q, n + q))
    block[:n, :n], block[:n, n:] = loop * step_s, e * step_s
    both = expm(block)
    return both[:n, :n], both[:n, n:]
