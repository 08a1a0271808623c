"""CPU time: a sweep in lockstep beside run by run, a log beside mcap's own writer."""

from __future__ import annotations

import gc
import statistics
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from hil.compose import compose
from hil.experiment import load_experiment
from hil.log.topics import channels_of
from hil.log.write import MemorySink, Sink
from hil.log.write.mcap_sink import McapSink
from hil.log.write.mcap_writer import Index
from hil.log.write.provenance import Provenance
from hil.rig.loop import Loop
from hil.runtime.virtual import run_virtual
from hil.sweeps.seeds import run_one_by_one, run_seeds
from tests.bench.plain_log import PlainSink

SWEEPS = ("dc-motor-hinf", "dc-motor-smith", "vtol-h2")
TURNS = 5
WARM_UP = 100

Row = dict[str, Any]


def bench_sweep(progress: Callable[[str], None] = lambda text: None, *, runs: int = 1000, alone: int = 8) -> list[Row]:
    """Return CPU time per run of a sweep in lockstep, and run by run, one row per experiment.

    Args:
        progress: called with what is being done.
        runs: in lockstep.
        alone: run by run.
    """
    rows = []
    for name in SWEEPS:
        progress(f"sweep {name}")
        loop = compose(load_experiment(name), certify=False)
        together = _cpu(partial(run_seeds, loop, range(runs))) / runs
        plain = _cpu(partial(run_one_by_one, loop, range(alone))) / alone
        rows.append(
            {
                "sweep": name,
                "slots": loop.experiment.slots,
                "lockstep us per run": round(together * 1e6, 1),
                "run by run us": round(plain * 1e6, 1),
                "ratio": round(plain / together, 1),
            }
        )
    return rows


def bench_log(progress: Callable[[str], None] = lambda text: None, *, slots: int = 5000, turns: int = TURNS) -> list[Row]:
    """Return CPU time per virtual slot with our log, with mcap's own writer and without a log: medians of turns.

    Args:
        progress: called with what is being done.
        slots: of one run.
        turns: how often all three are run.
    """
    progress("virtual slot")
    loop = compose(load_experiment("dc-motor-hinf", [f"duration={slots * 0.05!r}"]), certify=False)
    found: dict[str, list[float]] = {"ours": [], "plain": [], "none": []}
    with tempfile.TemporaryDirectory(prefix="hilrig-bench-") as folder:
        for _ in range(turns):
            for name in found:
                found[name].append(_cpu(partial(_virtual, loop, name, Path(folder) / name)) / slots * 1e6)
        equal = (Path(folder) / "ours").read_bytes() == (Path(folder) / "plain").read_bytes()
        _virtual(loop, "chunk", Path(folder) / "chunk")
        full, chunk = ((Path(folder) / name).stat().st_size / slots for name in ("ours", "chunk"))
    ours, plain, none = (statistics.median(found[name]) for name in ("ours", "plain", "none"))
    return [
        {
            "virtual slot": "dc-motor-hinf with log",
            "us": round(ours, 1),
            "mcap's writer us": round(plain, 1),
            "ratio": round(ours / plain, 3),
            "without log us": round(none, 1),
            "same bytes": equal,
            "bytes": round(full, 1),
            "bytes, --index chunk": round(chunk, 1),
            "ratio of bytes": round(chunk / full, 3),
        }
    ]


def bench_memory(
    progress: Callable[[str], None] = lambda text: None, *, slots: tuple[int, int] = (4_000, 12_000)
) -> list[Row]:
    """Return how many bytes every further slot holds in memory while its log is open, ours and mcap's own writer.

    Args:
        progress: called with what is being done.
        slots: lengths of the two runs that are compared.
    """
    progress("memory of a log")
    held: dict[str, list[int]] = {"ours": [], "plain": []}
    with tempfile.TemporaryDirectory(prefix="hilrig-bench-") as folder:
        for count in (WARM_UP, *slots):  # what the first run imports and keeps belongs to no slot
            loop = compose(load_experiment("dc-motor-hinf", [f"duration={count * 0.05!r}"]), certify=False)
            for name, found in held.items():
                tracemalloc.start()
                _virtual(loop, name, Path(folder) / name, lambda own=found: own.append(_traced()))  # type: ignore[misc]
                tracemalloc.stop()
    ours, plain = ((held[name][2] - held[name][1]) / (slots[1] - slots[0]) for name in ("ours", "plain"))
    return [
        {
            "memory": "of a log while it is written",
            "bytes per slot": round(ours, 2),
            "mcap's writer": round(plain, 2),
            "ratio": round(ours / plain, 3) if plain > 0.0 else None,
        }
    ]


def _traced() -> int:
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def _virtual(loop: Loop, writer: str, path: Path, before_the_end: Callable[[], None] = lambda: None) -> None:
    about = Provenance(experiment="bench", experiment_text="", resolved={}, seed=0, clock="virtual", link="memory:")
    if writer == "none":
        run_virtual(loop, 0, MemorySink(channels_of(loop), []))
        return
    sink: Sink
    ours: Index = "chunk" if writer == "chunk" else "full"
    channels = channels_of(loop)
    made = PlainSink(path, channels, about) if writer == "plain" else McapSink(path, channels, about, index=ours)
    with made as sink:
        run_virtual(loop, 0, sink)
        before_the_end()


def _cpu(task: Callable[[], object]) -> float:
    begun = time.process_time()
    task()
    return time.process_time() - begun
