"""The test of a plant that jumps before a run: its motion is compared with the matrices of its modes, its jumps with its rates.

Two runs of one seed, one with inputs and one without, go through the same modes. In the last part of every slot their difference
must move by dx/dt = A_i dx + A_di dx(t - tau) + B_i u, within what the plant says is uncertain, entry by entry; and a third run,
advanced by whole slots, must meet the first. The jumps that are seen are counted beside the integral of their rates.
Where sensors fail by mode the motion is that of the stated state, and what is measured must be S_i x of one of the modes.
"""

from __future__ import annotations

import math
from collections import deque
from typing import cast

import numpy as np

from hil.certify import CertificationProblem, Check
from hil.certify.motion_test import SEED, random_inputs
from hil.rig.loop import Array
from plants.parts.protocols import JumpPlant, PlantRun
from plants.parts.semi_markov import JumpModel, JumpRates

SIZES = (1e-3, 1e3)
SLOTS, RUNS, SEEN = 40, 8, 15
"""Slots of a run, the most runs, and the least number of slots in every mode."""
WAIT, STRIDE = 1000, 4
"""Slots for which a run waits at most until it shows a mode that was not met, and how many it goes at once."""
PART = 64
"""The last part of a slot in which a derivative is measured: a 64th of it, at most `SHORTEST` of the fastest motion's time."""
SHORTEST = 1e-3
CLOSE = 1e-4
"""Share of the motion's speed by which a measured derivative may miss: of second order in the part's length."""
JUMPED = 0.03
"""Share of the parts in which a jump may have fallen unseen."""
UNLIKELY = 1e-6
"""Chance of a count of jumps so far from its mean, by Chernoff's bound: one right plant in a million is refused."""
COUNTED, AT_ONCE = 5000, 6
"""Slots over which jumps are counted, and how many pass at once where the rates are slow."""
MISSED = 0.1
"""Most jumps in a step of the count: what comes back within a step is not seen."""
ENOUGH = 40.0
"""Jumps that are to be expected before the count ends early."""
NAME = "your plant does not move as its model() says"


def jump_check(loop: CertificationProblem) -> Check:
    """Compare a plant's motion with its matrices and rates; return a state and its reason, or None and what was found equal."""
    plant = cast(JumpPlant, loop.plant)
    system = loop.once("jump system", plant.jump_system)
    rates = loop.once("jump process", plant.jump_process)
    first = rates.initial_detected if rates.detection else rates.initial
    begun = {int(plant.start(np.random.default_rng((SEED, turn))).measure()[-1]) for turn in range(RUNS)}
    if first and not begun <= set(first):
        other, stated = (" and ".join(map(str, sorted(modes))) for modes in (begun - set(first), first))
        return "refused", f"{NAME}: it begins in mode {other}, and states that it begins in {stated}"
    found = [_missed(loop, plant, system, bool(rates.detection), size) for size in SIZES]
    reasons = [reason for reason, _, _ in found]
    if reasons[0]:
        return "refused", f"{NAME}: {reasons[0]}"
    if any(reasons):
        return "undecided", f"non-linear: the plant moves as its model says under small inputs, but {next(filter(None, reasons))}"
    said = f"the plant moves in its modes as its model says: compared in {found[0][1]} slots, random inputs of 0.001 to 1000"
    unmet = [str(mode + 1) for mode in range(len(system.A)) if mode not in found[0][2]]
    said += f"; modes {', '.join(unmet)} were not met" if unmet else ""
    if rates.detection and rates.initial and len(rates.reached()[0]) < len(system.A):
        said += f"; that it begins in true mode {', '.join(map(str, rates.initial))} is as it states, and not seen"
    if rates.detection:
        return None, (said, "its modes change at the rates that it states: not compared, as the true mode is not measured")
    wrong = _counted(plant, rates, loop.model.period_s, costly=bool(system.Ad))
    if wrong:
        return "refused", f"{NAME}: {wrong}"
    slots = COUNTED // 5 if system.Ad else COUNTED
    return None, (said, f"its modes change at the rates that it states: counted over {slots} slots at most")


def _missed(
    loop: CertificationProblem, plant: JumpPlant, system: JumpModel, hidden: bool, size: float
) -> tuple[str, int, set[int]]:
    """Return why the motion is not that of the modes, empty where it is; how many slots were compared, and the modes met."""
    A, B = np.array(system.A, dtype=float), np.array(system.B, dtype=float)
    n, m, modes = A.shape[1], B.shape[2], len(A)
    delayed = np.array(system.Ad, dtype=float) if system.Ad else None
    changes = [(np.array(dA, dtype=float), np.array(dB, dtype=float)) for dA, dB in system.changes]
    period_ns = round(loop.model.period_s * 1e9)
    fastest = float(np.abs(A).sum(axis=2).max()) + 1e-9
    part_ns = max(1, min(period_ns // PART, round(1e9 * SHORTEST / fastest)))
    past = deque[Array](maxlen=2 * math.ceil(1e9 * system.max_delay_s / period_ns) + 4)
    compared, missed, met = 0, 0, dict.fromkeys(range(modes), 0)
    first, still = "", (0.0,) * m
    for turn in range(RUNS):
        wanted = min(met, key=lambda mode: met[mode])
        if turn and met[wanted] >= SEEN:
            break
        moved, rest, whole = (plant.start(np.random.default_rng((SEED, turn))) for _ in range(3))
        for _ in range(WAIT // STRIDE if turn else 0):
            if int(rest.measure()[-1]) - 1 == wanted or not np.abs(rest.measure()).max() < 1e6:
                break
            for run in (moved, rest, whole):
                run.advance(STRIDE * period_ns, still, still)
        past.clear()
        past.append(np.zeros(n))
        for k, u in enumerate((size * random_inputs(SLOTS, m)).tolist()):
            before: list[Array] = []
            seen: list[int] = []
            for span_ns in (period_ns - part_ns, part_ns):
                moved.advance(span_ns, u, still)
                rest.advance(span_ns, still, still)
                shown = np.array(moved.measure())
                y, z = (_of_state(run, n, system) for run in (moved, rest))
                if system.S and not _shows(shown, y, system):
                    return f"in slot {k} what is measured is S_i x of no mode", compared, set()
                if y[-1] != z[-1]:
                    return f"in slot {k} its mode depends on its inputs", compared, set()
                before.append(y[:n] - z[:n])
                seen.append(int(y[-1]) - 1)
            whole.advance(period_ns, u, still)
            x, size_now = _of_state(whole, n, system), float(np.abs(y).max()) + 1e-300
            if not np.isfinite(y).all() or np.abs(before[-1]).max() > 1e12 * size:
                break
            if np.abs(x - y).max() > 1e-6 * size_now:
                return f"cut in two, slot {k} ends elsewhere, by {np.abs(x - y).max():.3g}", compared, set()
            rounding = 1e-13 * (size_now + float(np.abs(z).max())) / (part_ns / 1e9)
            if seen[0] == seen[1]:
                compared += 1
                candidates = range(modes) if hidden else (seen[1],)
                gaps = [_gap(before, np.array(u), i, A, B, delayed, changes, past, part_ns / 1e9, rounding) for i in candidates]
                met[seen[1] % modes] += 1
                if min(gaps) > CLOSE:
                    missed += 1
                    where = f"inputs up to {size:g} in mode {seen[1] + 1}"
                    first = first or f"{where}: its speed in slot {k} misses the model's by {min(gaps):.2g} of it"
            past.extend(before)
    if missed > max(2, JUMPED * compared):
        return f"{first} ({missed} of {compared} slots)", compared, set()
    return "", compared, {mode for mode, count in met.items() if count}


def _of_state(run: PlantRun, n: int, system: JumpModel) -> Array:
    """The state and the mode seen: what is measured, or, where sensors fail, what the plant states."""
    y = np.array(run.measure())
    return np.append(run.state[:n], y[-1]) if system.S else y


def _shows(y: Array, x: Array, system: JumpModel) -> bool:
    size = float(np.abs(x).max()) + 1e-300
    return any(np.abs(np.array(S) @ x[:-1] - y[:-1]).max() <= 1e-9 * size for S in system.S)


def _gap(
    before: list[Array], u: Array, i: int, A: Array, B: Array, delayed: Array | None, changes: list[tuple[Array, Array]],
    past: deque[Array], dt: float, rounding: float,
) -> float:  # fmt: skip
    """Return by how much the measured derivative leaves what mode i allows, state by state, as a share of its own speed.

    The speed of a state is what its row of the matrices makes of the largest state: a slow one beside a fast one has its own.
    """
    first, last = before
    speed, middle = (last - first) / dt, 0.5 * (first + last)
    reach = float(np.abs(middle).max())
    low = high = A[i] @ middle + B[i] @ u
    scale = np.abs(A[i]).sum(axis=1) * reach + np.abs(B[i] @ u) + 1e-300
    if changes:
        free = np.array([dA[i] @ middle + dB[i] @ u for dA, dB in changes])
        low, high = low + free.min(axis=0), high + free.max(axis=0)
        scale += sum(np.abs(dA[i]).sum(axis=1) for dA, _ in changes) * reach + np.abs(free).max(axis=0)
    if delayed is not None:
        late = np.array([delayed[i] @ x for x in (*past, first, last)])
        spread = 0.5 * np.abs(np.diff(late, axis=0)).max(axis=0)
        low, high = low + late.min(axis=0) - spread, high + late.max(axis=0) + spread
        scale += np.abs(delayed[i]).sum(axis=1) * max(float(np.abs(x).max()) for x in (*past, first, last))
    outside = np.maximum(np.maximum(low - speed, speed - high) - rounding, 0.0)
    return float((outside / scale).max())


def _counted(plant: JumpPlant, rates: JumpRates, period_s: float, *, costly: bool) -> str:
    """Return which jump occurs too often or too seldom, a phrase; empty: none. `costly`: simulating the plant is slow."""
    table, N = rates.rates, rates.rates.modes
    counts, mean = np.zeros((N, N)), np.zeros((N, N))
    largest = np.array(table.rates).max(axis=0)
    np.fill_diagonal(largest, 0.0)
    step_s = min(AT_ONCE * period_s, MISSED / max(float(largest.sum(axis=1).max()), 1e-9))
    step_ns, still = max(round(step_s * 1e9), 1), (0.0,) * len(plant.inputs)
    slots = COUNTED // 5 if costly else COUNTED
    steps, turns = min(round(slots * period_s / step_s), slots), 5
    for turn in range(turns):
        run = plant.start(np.random.default_rng((SEED + 1, turn)))
        mode, since = int(run.measure()[-1]) - 1, 0.0
        for _ in range(steps // turns):
            run.advance(step_ns, still, still)
            mean[mode] += step_s * np.array(table.at(mode + 1, since + 0.5 * step_s))
            since += step_s
            now = int(run.measure()[-1]) - 1
            if now != mode:
                counts[mode, now] += 1
                mode, since = now, 0.5 * step_s
            if not all(map(math.isfinite, run.state)):
                break
        if mean.sum() > ENOUGH:
            break
    # a jump with others behind it in its step shows the last mode
    seen = mean @ np.linalg.inv(np.eye(N) - 0.5 * step_s * largest)
    judged = [("", counts.sum(), mean.sum(), mean.sum())] + [
        (f" from mode {i + 1} to {j + 1}", counts[i, j], mean[i, j], seen[i, j]) for i in range(N) for j in range(N) if i != j
    ]
    for of, c, m, high in judged:
        nearest = min(max(c, m * (1.0 - MISSED)), high)  # an unseen return makes the count smaller
        if c and not nearest:
            return f"it jumped{of} {int(c)} times, where its rates have none"
        if (c * math.log(c / nearest) if c else 0.0) - c + nearest > -math.log(UNLIKELY):
            return f"it jumped{of} {int(c)} times, where its rates have {m:.3g}"
    return ""
