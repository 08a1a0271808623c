"""The SHA-256 of every shipped experiment and of numbers of studies: ``python -m tests.records_sha256`` writes them anew.

They stand in ``tests/data/records_sha256.json``. Every machine has to come to the same, see `tests/test_same_everywhere.py`.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Iterator
from itertools import pairwise, starmap
from pathlib import Path

import numpy as np

from design.controllers.scheduled_gain import ScheduledGain
from design.jump_linear import MJLS
from design.monte_carlo import JUMPS, uniforms
from design.monte_carlo.jump_loop import JumpLoop
from design.monte_carlo.studies import mjls_energies, settling_times
from design.processes.elementary import log
from design.processes.further_rates import BathtubRate, ColdStandbyRate, KOutOfNRate
from design.processes.rates import WeibullRate, clip_rate
from design.processes.semi_markov import SemiMarkov
from design.semi_markov_loop import JumpSystem
from hil.compose import compose
from hil.experiment import load_experiment, shipped
from hil.log.run import records_sha256
from hil.runtime.virtual import simulate
from hil.sweeps.seeds import run_seeds

FILE = Path(__file__).parent / "data" / "records_sha256.json"
SWEPT = ("dc-motor-hinf", "dc-motor-smith", "dc-motor-packets", "multisensor-ours", "vtol-delayed")
"""Together and one by one, with draws of every kind."""

RUNS = 1000
AGEING = SemiMarkov(
    rates=(
        (None, WeibullRate(scale_s=1.0, shape=0.7), KOutOfNRate(needed=2, installed=4, rate=0.8)),
        (clip_rate(0.1, 4.6), None, ColdStandbyRate(installed=5, rate=3.0)),
        (BathtubRate(infant=3.0, infant_time_s=0.4, useful=0.2, wear=1.5, wear_start_s=0.6, wear_span_s=2.0), None, None),
    )
)
SPLITS: dict[str, list[int]] = {
    "whole": [0, RUNS], "odd": [0, 1, 2, 3, 140, 147, 999, RUNS], "sevens": [*range(0, 70, 7), RUNS],
}  # fmt: skip
SLOTS = 2000
"""At most so many: 5 s of every experiment but those at 1 kHz."""


def experiments() -> Iterator[tuple[str, str]]:
    """Give every shipped experiment and the SHA-256 of its records over 5 s, or `SLOTS`."""
    for name in shipped():
        experiment = load_experiment(name, duration="5")
        if experiment.slots > SLOTS:
            experiment = load_experiment(name, duration=repr(experiment.period_ns * SLOTS / 1e9))
        loop = compose(experiment, certify=False)
        if loop.gains is not None and loop.gains.origin != "stored":
            raise SystemExit(f"{name}: {loop.gains.note}")
        yield name, records_sha256(simulate(loop, experiment.seed))


def sweeps(parts: int) -> Iterator[tuple[str, str]]:
    """Give the SHA-256 of sweeps of seven runs, computed in so many parts."""
    for name in SWEPT:
        loop = compose(load_experiment(name, duration="2"), certify=False)
        edges = np.linspace(0, 7, parts + 1).astype(int).tolist()
        rows = [row for a, b in pairwise(edges) for row in run_seeds(loop, list(range(a, b)))]
        yield f"sweep {name}", _sha256(repr([sorted(row.items()) for row in rows]).encode())


def jumps(edges: list[int]) -> str:
    """Return the SHA-256 of 1000 next jumps, computed in parts that end at some places."""
    mode = np.arange(RUNS) % AGEING.modes
    draws = uniforms(1, 0, RUNS, blocks=1, purpose=JUMPS)
    age = np.where(draws[2] < 0.5, 0.0, draws[3])
    parts = [AGEING.jump(mode[s], age[s], -log(draws[0, s]), draws[1, s]) for s in starmap(slice, pairwise(edges))]
    return _sha256(np.concatenate([h for h, _ in parts]).tobytes() + np.concatenate([t for _, t in parts]).tobytes())


def studies() -> Iterator[tuple[str, str]]:
    """Give the SHA-256 of Monte Carlo studies."""
    a = [[[-1.0, 0.3], [0.2, -0.7]], [[0.1, 1.0], [0.4, -0.5]], [[-0.4, 0.1], [0.0, -0.9]]]
    gain = ScheduledGain(gain=np.full((3, 2, 1, 2), -0.6), starts_s=np.array([[0.0, 0.5]] * 3))
    loop = JumpLoop(system=JumpSystem(a=np.array(a), b=np.ones((3, 2, 1))), gain=gain, process=AGEING, start=(1.0, -2.0))
    yield "settling times", _sha256(settling_times(loop, 20, duration_s=10.0).tobytes())
    A, ones = np.array([[[0.9, 0.2], [0.0, 0.7]], [[1.02, 0.1], [-0.3, 0.5]]]), np.ones((2, 1, 2))
    system = MJLS(A=A, B=np.ones((2, 2, 1)), C=ones, transition=[[0.9, 0.1], [0.4, 0.6]])
    yield "jump-linear batch", _sha256(mjls_energies(system, 200, 40, start=(1.0, 2.0)).tobytes())


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def found(parts: int = 1, split: str = "whole") -> dict[str, str]:
    """Return everything, name to SHA-256; the split of sweeps and of jumps must make no difference.

    Args:
        parts: of a sweep.
        split: of the jumps, see `SPLITS`.
    """
    return {**dict(experiments()), **dict(sweeps(parts)), "jumps": jumps(SPLITS[split]), **dict(studies())}


if __name__ == "__main__":
    if sys.argv[1:]:
        print(json.dumps(found(int(sys.argv[1]), sys.argv[2])))
    else:
        FILE.write_text(json.dumps(found(), indent=1) + "\n")
