"""Random loops whose actuator saturates: where they begin decides; how often they leave their limit is counted in drawn runs."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np

from hil.certify import CertificationProblem
from plants import Departure, Signal
from tests.hil.compose.random_loops import Array, Flat
from tests.hil.compose.random_table_loops import send_all_draw, send_all_radius

RUNS, SLOTS, MOST = 400, 200, 18
"""More than 18 of 400 runs leave at a probability of 0.01 in one of 3e7 loops; at 0.1 in all but one of 1e5."""


@dataclass(frozen=True, kw_only=True)
class Limited(Flat):
    """A plant whose input saturates at 1."""

    begins: tuple[float, ...] = ()

    @property
    def states(self) -> tuple[Signal, ...]:  # type: ignore[override]
        return tuple(Signal(f"x{i}", "1") for i in range(len(self.begins)))

    def beyond_model(self) -> tuple[str, ...]:
        return ("saturation",)

    def departures(self) -> tuple[Departure, ...]:
        return (Departure("saturation", "input", (0.0,), (1.0,)),)

    def start(self, rng: np.random.Generator) -> Any:
        return SimpleNamespace(state=self.begins)


def leaving_runs(A: Array, B: Array, K: Array, sc: Array, ca: Array, begins: Array, rng: np.random.Generator) -> int:
    """Runs in which a command passes 1, sample by sample and packet by packet, without any closed-loop matrix."""
    taus, ds = K.shape[:2]
    x, left, every = np.tile(begins, (RUNS, 1)), np.zeros(RUNS, dtype=bool), np.arange(RUNS)
    tau, d = rng.integers(taus, size=RUNS), rng.integers(ds, size=RUNS)
    samples: list[Array] = []
    packets: list[Array] = []
    for k in range(SLOTS):
        samples.append(x.copy())
        sample = np.stack([samples[k - t] if k >= t else np.zeros_like(x) for t in range(taus)])[tau, every]
        packets.append(np.einsum("rdn,rn->rd", K[tau, :, 0], sample))  # no sample yet: a packet of zeros
        newest = np.stack([packets[k - a] if k >= a else np.zeros((RUNS, ds)) for a in range(ds)])[d, every]
        u = newest[every, d]
        left |= np.abs(u) > 1.0
        x = x @ A.T + np.clip(u, -1.0, 1.0)[:, None] * B[:, 0]
        tau, d = ((rng.random(RUNS)[:, None] > P.cumsum(axis=1)[at]).sum(axis=1) for P, at in ((sc, tau), (ca, d)))
        tau, d = np.minimum(tau, taus - 1), np.minimum(d, ds - 1)
    return int(left.sum())


def limited_case(rng: np.random.Generator) -> tuple[CertificationProblem, float]:
    """The loop; its exact radius where that is above 1, else 0.5 where its runs stay within the limit, and 1.5 elsewhere."""
    taus, ds = int(rng.integers(1, 4)), int(rng.integers(1, 3))
    loop, K = send_all_draw(rng, taus, ds)
    assert loop.sc is not None and loop.ca is not None
    A, B, sc, ca = loop.model.A, loop.model.B, loop.sc.matrix, loop.ca.matrix
    begins = rng.normal(size=len(A))
    begins *= np.exp(rng.uniform(np.log(0.05), np.log(1.5))) / np.abs(K[:, :, 0] @ begins).max()
    loop = msgspec.structs.replace(loop, plant=Limited(begins=tuple(begins.tolist())))
    growth = send_all_radius(A, B, K, sc, list(range(taus)), ca)
    if growth <= 1.0:
        growth = 1.5 if leaving_runs(A, B, K, sc, ca, begins, rng) > MOST else 0.5
    return loop, growth
