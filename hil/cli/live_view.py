"""The terminal view while a session runs: how far, how well, which delays, how late.

Records arrive through `LiveView.taps` in the session's process (never in a loop process) and only the newest of a
topic is kept; it is decoded when the picture is drawn, ten times a second. All times are session times from the
records, so the view reads no clock of its own.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from functools import partial
from struct import Struct
from types import TracebackType
from typing import TYPE_CHECKING, Any

import numpy as np

from hil.cli.terminal import visible
from hil.log import Logged, decode_event
from hil.log.records import CDR_HEADER, EVENTS_TOPIC
from hil.log.topics import APPLIED, MEASUREMENT, REFERENCE, ROWS, TIMING, channels
from hil.measure.signals import PURE, tracked_among
from hil.measure.summary import percentiles
from hil.pages.html import text_of
from plants.parts import Signal

if TYPE_CHECKING:
    from rich.console import Console, RenderableType
    from rich.live import Live

    from hil.experiment import Experiment
    from hil.log.write import PayloadWriter

REFRESH_HZ = 10
RECENT = 2000
"""Slots over which lateness percentiles and delay shares are shown."""

LONGEST_NAME = 20
SHOWN = (MEASUREMENT.name, REFERENCE.name, APPLIED.name, ROWS.name, TIMING.name, EVENTS_TOPIC)

_TAU = Struct("<ii")  # `/controller/rows` ends with tau and selection, however many rows stand before
_BLOCKS = "▁▂▃▄▅▆▇█"
_STYLES = {"warning": "yellow", "error": "bold red"}


class LiveView:
    """Draws a running session on standard error; does nothing at all when that is no terminal.

    Args:
        experiment: what runs.
        clock: "virtual" or "real".
        link: URI of the link; the experiment's own by default.
        console: where to draw; standard error by default.

    Use it as a context manager and give `taps` to `run_session`; leaving it, also by an exception or Ctrl-C, stops the
    drawing, removes the view and shows the cursor again.
    """

    def __init__(self, experiment: Experiment, clock: str, *, link: str | None = None, console: Console | None = None) -> None:
        from rich.console import Console

        self._console = console or Console(stderr=True)
        self._begun = self._console.get_time()
        self._on = self._console.is_terminal and not self._console.is_dumb_terminal
        self._experiment = experiment
        self._where = "virtual time" if clock == "virtual" else f"real time · {link or experiment.links.uri}"
        plant = experiment.plant
        self._plant = plant
        self._tracked = tracked_among(plant, [signal.name for signal in plant.outputs])
        self._name_width = min(max(10, *(len(signal.name) for signal in plant.outputs)), LONGEST_NAME)
        table = channels(Logged(states=plant.states, inputs=plant.inputs, outputs=plant.outputs, n_rows=1))
        self._dtypes = {topic: channel.schema.dtype for topic, channel in table.items()}
        self._newest: dict[str, bytes] = {}
        self._t_ns = -1
        self._taus: deque[int] = deque(maxlen=RECENT)
        self._ds: deque[int] = deque(maxlen=RECENT)
        self._lateness: deque[float] = deque(maxlen=RECENT)
        self._errors: deque[float] = deque(maxlen=36)
        self._worst = 0.0
        self._late = 0
        self._overruns = 0
        self._events: deque[dict[str, Any]] = deque(maxlen=4)
        self._live: Live | None = None

    @property
    def taps(self) -> Mapping[str, PayloadWriter]:
        """Topic to the function that takes its records; empty when there is no terminal to draw on."""
        return {topic: partial(self.update, topic) for topic in SHOWN} if self._on else {}

    def update(self, topic: str, t_ns: int, payload: bytes) -> None:
        """Take one record of any topic; those that are not shown are ignored."""
        if topic == ROWS.name:
            self._taus.append(_TAU.unpack_from(payload, len(payload) - _TAU.size)[0])
        elif topic == EVENTS_TOPIC:
            self._events.append(decode_event(payload))
        elif topic == TIMING.name:
            self._newest[topic] = payload
            slot = self._record(topic, payload)
            self._lateness.append(float(slot["lateness_us"]))
            self._worst = max(self._worst, float(slot["lateness_us"]))
            self._late += int(slot["late"])
            self._overruns += int(slot["overrun"])
        elif topic in SHOWN:
            self._newest[topic], self._t_ns = payload, t_ns
            if topic == APPLIED.name and (d := int(self._record(topic, payload)["d"])) >= 0:
                self._ds.append(d)

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
        done_s = max(self._t_ns, 0) / 1e9
        head = Text.assemble((visible(e.name), "bold"), (f"  seed {e.seed} · {visible(self._where)}", "dim"))
        if self._t_ns < 0:
            waited = int(self._console.get_time() - self._begun)
            what = "starting" if "real" in self._where else "computing"
            return Group(head, Text(f"{what} … {f'{waited} s' if waited else ''}", style="dim"))
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
        y, r = self._decoded(MEASUREMENT.name), self._decoded(REFERENCE.name)
        if y is None or r is None:
            return []
        rows = []
        for i, signal in enumerate(self._plant.outputs):
            now, wanted = float(y[i]), float(r[i])
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
        applied = self._decoded(APPLIED.name)
        if applied is None:
            return []
        return [("input", "   ".join(_quantity(float(applied[i]), signal) for i, signal in enumerate(self._plant.inputs)))]

    def _delays(self) -> list[tuple[str, str]]:
        shown: list[tuple[str, str]] = []
        for name, values in (("τ", list(self._taus)), ("d", list(self._ds))):
            if values:
                shares = ", ".join(f"{age}: {100 * n / len(values):.0f} %" for age, n in sorted(Counter(values).items()))
                shown.append(("" if shown else "delays", f"{name} = {values[-1]} ({shares})"))
        return shown

    def _times(self) -> list[tuple[str, str]]:
        if not self._lateness:
            return []
        lateness = percentiles(np.array(self._lateness))
        slot = self._decoded(TIMING.name)
        trip = float(slot["round_trip_us"]) if slot is not None else float("nan")
        known = {name: us for name, us in lateness.items() if name in ("p50", "p99") and us is not None}
        text = "   ".join(f"{name} {us:.0f} µs" for name, us in (known | {"max": self._worst}).items())
        missed = f"{self._late} late, {self._overruns} overruns"
        return [("lateness", text), ("round trip", f"{text_of(trip, 3)} µs"), ("missed", missed)]

    def _decoded(self, topic: str) -> np.void | None:
        payload = self._newest.get(topic)
        return None if payload is None else self._record(topic, payload)

    def _record(self, topic: str, payload: bytes) -> np.void:
        found: np.void = np.frombuffer(payload, self._dtypes[topic], 1, len(CDR_HEADER))[0]
        return found


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
