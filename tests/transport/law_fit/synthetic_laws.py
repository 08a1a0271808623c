"""Twenty network laws whose class is known, and records of packets under them, by the emulator's own draws."""

from __future__ import annotations

import numpy as np

from transport.law_fit.packet_record import PacketRecord
from transport.laws import NetworkLaw
from transport.laws.age import MarkovAge
from transport.laws.packet import GilbertElliott, PacketLaw
from transport.laws.semi_markov import SemiMarkovAge
from transport.laws.sojourn import DiscreteWeibull, Geometric, Table, Uniform

T, DEADLINE = 0.010, 0.006


def packets(latency: object, loss: float | GilbertElliott = 0.0) -> PacketLaw:
    return PacketLaw(latency=latency, loss=loss)  # type: ignore[arg-type]


def dist(name: str, **fields: float | str) -> dict[str, float | str]:
    return {"dist": name, **fields}


TWO_WAYS = ((0.0, 1.0), (1.0, 0.0))
LAWS: tuple[tuple[str, NetworkLaw], ...] = (
    ("constant", packets("3 ms")),
    ("independent", packets(dist("gamma", a=3.0, loc="2 ms", scale="1 ms"))),
    ("independent", packets(dist("gamma", a=2.0, scale="4 ms"), 0.05)),
    ("independent", packets(dist("lognorm", s=0.5, scale="5 ms"), 0.01)),
    ("independent", packets(dist("weibull_min", c=1.5, scale="6 ms"))),
    ("independent", packets(dist("expon", loc="1 ms", scale="5 ms"), 0.2)),
    ("independent", packets(dist("uniform", loc="1 ms", scale="30 ms"))),
    ("independent", packets(dist("norm", loc="20 ms", scale="2 ms"), 0.001)),
    ("independent", packets({"table": [[0, "1 ms"], [0.5, "2 ms"], [0.5, "8 ms"], [1, "9 ms"]]})),
    ("gilbert-elliott", packets(dist("gamma", a=3.0, scale="2 ms"), GilbertElliott(p_gb=0.02, p_bg=0.25, loss_bad=0.5))),
    ("gilbert-elliott", packets(dist("lognorm", s=0.7, scale="5 ms"),
                                GilbertElliott(p_gb=0.03, p_bg=0.3, loss_good=0.01, loss_bad=0.7))),
    ("gilbert-elliott", packets("2 ms", GilbertElliott(p_gb=0.01, p_bg=0.4))),
    ("markov", MarkovAge(matrix=((0.6, 0.4, 0.0), (0.7, 0.2, 0.1), (0.8, 0.1, 0.1)))),
    ("markov", MarkovAge(matrix=((0.9, 0.1), (0.3, 0.7)))),
    ("markov", MarkovAge(matrix=((0.5, 0.5), (0.7, 0.3)))),
    ("markov", MarkovAge(matrix=((0.95, 0.05, 0.0, 0.0), (0.5, 0.3, 0.2, 0.0), (0.2, 0.2, 0.3, 0.3), (0.4, 0.2, 0.2, 0.2)))),
    ("semi-markov", SemiMarkovAge(matrix=TWO_WAYS, sojourn=(DiscreteWeibull(q=0.8, beta=0.6), Geometric(p=0.4)))),
    ("semi-markov", SemiMarkovAge(matrix=TWO_WAYS, sojourn=(Uniform(low=3, high=8), Uniform(low=1, high=4)))),
    ("semi-markov", SemiMarkovAge(matrix=((0.0, 1.0, 0.0), (0.5, 0.0, 0.5), (0.6, 0.4, 0.0)), sojourn=(
        DiscreteWeibull(q=0.7, beta=1.6), Geometric(p=0.5), Table(probabilities=(0.2, 0.2, 0.6))))),
    ("semi-markov", SemiMarkovAge(matrix=TWO_WAYS, sojourn=(Geometric(p=0.2), Table(probabilities=(0.1, 0.0, 0.0, 0.9))))),
)  # fmt: skip


def record_of(law: NetworkLaw, n: int, seed: list[int]) -> PacketRecord:
    """What n packets do under a law: a packet law says of each; under an age law some are overtaken and never seen."""
    rng, sent = np.random.default_rng(seed), np.arange(n) * T
    latency = np.full(n, np.nan)
    if isinstance(law, PacketLaw):
        process = law.start(rng, T, DEADLINE)
        for k in range(n):
            draw = process.draw(k)[0]
            latency[k] = draw.latency_s if draw.age >= 0 else np.nan
        return PacketRecord(sent_s=sent, latency_s=latency)
    ages, newest, until = law.start(rng), -1, np.arange(n, 0, -1) * T  # type: ignore[call-arg, arg-type]
    for k in range(n):
        packet = k - ages.draw()[1]  # type: ignore[union-attr]
        if packet > newest:
            latency[packet] = (k - packet) * T
            overtaken = np.arange(newest + 1, packet)
            until[overtaken] = (k - overtaken) * T
            newest = packet
    return PacketRecord(sent_s=sent, latency_s=latency, until_s=until)
