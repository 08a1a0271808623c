"""The terminal view while a session runs: how far, how well, which delays, how late.

Records arrive in the session's process (never in a loop process), and the newest of a topic are kept; they are decoded when the
picture is drawn, ten times a second. All times are session times from the records, so the view reads no clock of its own.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.cli.terminal import visible
from hil.log import decode_event
from hil.log.records import EVENTS_TOPIC, Channel
from hil.log.topics import APPLIED, MEASUREMENT, REFERENCE, ROWS, TIMING
from hil.measure.signals import PURE, tracked_among
from hil.measure.summary import percentiles
from hil.pages.html import text_of
from hil.pages.live import Records, Tail
from plants.parts import Signal
from transport.links.traits import in_short

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live

    from hil.experiment import Experiment
    from hil.log.write import PayloadWriter
    from hil.rig.loop import Loop

REFRESH_HZ = 10
RECENT = 2000
"""Slots over which lateness percentiles and delay shares are shown."""

LONGEST_NAME = 20
SHOWN = (MEASUREMENT.name, REFERENCE.name, APPLIED.name, ROWS.name, TIMING.name)

_BLOCKS = "▁▂▃▄▅▆▇█"
_STYLES = {"warning": "yellow", "error": "bold red"}


class LiveView:
    """Draws a running session on standard error; does nothing at all when that is no terminal.

    Args:
        experiment: what runs.
        clock: "virtual" or "real".
        link: URI of the link; the experiment's own by default.
        waits: for whom the rig waits; a line that is written when the run begins, and no earlier: then nothing refuses it.
        drawn: whether to draw; otherwise that line is all.
        console: where to draw; standard error by default.

    Use it as a context manager around `hil.session.run_session`, whose onlooker it is; leaving it, also by an exception or
    Ctrl-C, stops the drawing, removes the view and shows the cursor again.
    """

    def __init__(
        self, experiment: Experiment, clock: str, *, link: str | None = None, waits: str = "", drawn: bool = True,
        console: Console | None = None,
    ) -> None:  # fmt: skip
        from rich.console import Console

        self._console = console or Console(stderr=True)
        self._begun = self._console.get_time()
        self._waits = visible(waits)
        self._on = drawn and self._console.is_terminal and not self._console.is_dumb_terminal
        self._experiment = experiment
        self._where = "virtual time" if clock == "virtual" else f"real time · {in_short(link or experiment.links.uri)}"
        plant = experiment.plant
        self._plant = plant
        self._tracked = tracked_among(plant, [signal.name for signal in plant.outputs])
        self._name_width = min(max(10, *(len(signal.name) for signal in plant.outputs)), LONGEST_NAME)
        self._tails: dict[str, Tail] = {}
        self._errors: deque[float] = deque(maxlen=36)
        self._timed = -1  # the newest slot whose lateness is counted
        self._worst = 0.0
        self._late = 0
        self._overruns = 0
        self._events: deque[dict[str, Any]] = deque(maxlen=4)
        self._live: Live | None = None
        self.clock, self.changes = None, None  # it paces nothing, and changes nothing

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Take the records that are shown; none where there is no terminal to draw on."""
        if self._waits:
            self._console.print(self._waits, markup=False, highlight=False, soft_wrap=True)
        if not self._on:
            return {}
        schemas = {topic: channels[topic].schema for topic in SHOWN if topic in channels}
        self._tails = {topic: Tail(schema, RECENT * schema.dtype.itemsize) for topic, schema in schemas.items()}
        return {**{topic: tail.put for topic, tail in self._tails.items()}, EVENTS_TOPIC: self._event}

    def _event(self, t_ns: int, payload: bytes) -> None:
        self._events.append(decode_event(payload))

    def end(self) -> None:
        """It waits for nothing."""

    def __enter__(self) -> LiveView:
        if self._on:
            from rich.live import Live

            self._live = Live(
                console=self._console,
                get_renderable=self.render,
                refresh_per_second=REFRESH_HZ,
                transient=True,
                redirect_stdout=False,
                redirect_stderr=False,
            )
            self._live.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None

    def render(self) -> RenderableType:
        """Return the picture of this moment."""
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        e = self._experiment
        measured = self._newest(MEASUREMENT.name)
        head = Text.assemble((visible(e.name), "bold"), (f"  seed {e.seed} · {visible(self._where)}", "dim"))
        if not len(measured):
            waited = int(self._console.get_time() - self._begun)
            what = "starting" if "real" in self._where else "computing"
            return Group(head, Text(f"{what} … {f'{waited} s' if waited else ''}", style="dim"))
        done_s = int(measured["slot"][-1]) * e.period_ns / 1e9
        bar = Table.grid(padding=(0, 1), expand=True)
        bar.add_column(ratio=1)
        bar.add_column(justify="right", width=19)
        bar.add_row(
            ProgressBar(total=float(e.duration), completed=done_s, complete_style="cyan", finished_style="cyan"),
            Text(f"{done_s:.1f} of {float(e.duration):g} s", style="dim"),
        )
        lines = Table.grid(padding=(0, 2))
        lines.add_column(style="dim", width=self._name_width, no_wrap=True, overflow="ellipsis")
        lines.add_column(no_wrap=True, overflow="ellipsis")
        for row in (*self._tracking(), *self._input(), *self._delays(), *self._times()):
            lines.add_row(*row)
        events = [
            Text(f"{event.get('t_s', 0.0):8.3f} s  {visible(event.get('kind', ''))}: {visible(event.get('message', ''))}",
                 style=_STYLES.get(str(event.get("severity")), "dim"), no_wrap=True, overflow="ellipsis")
            for event in self._events
        ]  # fmt: skip
        return Group(head, bar, lines, *events)

    def _tracking(self) -> list[tuple[str, str]]:
        y, r = self._newest(MEASUREMENT.name), self._newest(REFERENCE.name)
        if not (len(y) and len(r)):
            return []
        rows = []
        for i, signal in enumerate(self._plant.outputs):
            now, wanted = float(y[-1][i]), float(r[-1][i])
            parts = [_quantity(now, signal)]
            if signal.name in self._tracked:
                parts += [f"error {text_of(now - wanted):<9}", f"reference {text_of(wanted):<6}"]
                if signal.name == self._tracked[0]:
                    self._errors.append(abs(now - wanted))
                    parts.append(sparkline(list(self._errors)))
            rows.append((signal.name, self._fitted(parts)))
        return rows

    def _fitted(self, parts: Sequence[str]) -> str:
        """Join as many parts as one line holds, the first always."""
        room = self._console.width - self._name_width - 2
        lines = ["   ".join(parts[: i + 1]).rstrip() for i in range(len(parts))]
        return next((line for line in reversed(lines) if len(line) <= room), lines[0])

    def _input(self) -> list[tuple[str, str]]:
        applied = self._newest(APPLIED.name)
        if not len(applied):
            return []
        parts = [_quantity(float(applied[-1][i]), signal) for i, signal in enumerate(self._plant.inputs)]
        return [("input", "   ".join(parts))]

    def _delays(self) -> list[tuple[str, str]]:
        shown: list[tuple[str, str]] = []
        for name, topic, field in (("τ", ROWS.name, "tau"), ("d", APPLIED.name, "d")):
            records = self._newest(topic)
            values = [age for age in (records[field].tolist() if len(records) else ()) if age >= 0 or topic == ROWS.name]
            if values:
                shares = ", ".join(f"{age}: {100 * n / len(values):.0f} %" for age, n in sorted(Counter(values).items()))
                shown.append(("" if shown else "delays", f"{name} = {values[-1]} ({shares})"))
        return shown

    def _times(self) -> list[tuple[str, str]]:
        timed = self._newest(TIMING.name)
        if not len(timed):
            return []
        new = timed[timed["slot"] > self._timed]
        self._timed, self._worst = int(timed["slot"][-1]), float(new["lateness_us"].max(initial=self._worst))
        self._late, self._overruns = self._late + int(new["late"].sum()), self._overruns + int(new["overrun"].sum())
        known = {name: us for name, us in percentiles(timed["lateness_us"]).items() if name in ("p50", "p99") and us is not None}
        text = "   ".join(f"{name} {us:.0f} µs" for name, us in (known | {"max": self._worst}).items())
        missed = f"{self._late} late, {self._overruns} overruns"
        trip = float(timed["round_trip_us"][-1])
        return [("lateness", text), ("round trip", f"{text_of(trip, 3)} µs"), ("missed", missed)]

    def _newest(self, topic: str) -> Records:
        """Return the newest records of a topic, `RECENT` at most."""
        tail = self._tails.get(topic)
        return np.empty(0, np.dtype([])) if tail is None else tail.records()[-RECENT:]


def _quantity(value: float, signal: Signal) -> str:
    unit = "" if signal.unit in PURE else f" {signal.unit}"
    return f"{text_of(value):>8}{unit}"


def sparkline(values: list[float]) -> str:
    """Return values as a line of blocks, the largest full.

    >>> sparkline([0.0, 1.0, 2.0]), sparkline([0.0, 0.0])
    ('▁▄█', '▁▁')
    """
    top = max((v for v in values if np.isfinite(v)), default=0.0)
    if top <= 0.0:
        return _BLOCKS[0] * len(values)
    return "".join(_BLOCKS[int(v / top * 7)] if np.isfinite(v) else "·" for v in values)
