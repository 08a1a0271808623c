import io
from collections.abc import Mapping
from typing import TypeAlias

import pytest
from rich.console import Console
from rich.text import Text

from hil.cli.live_view import LiveView
from hil.compose import compose
from hil.experiment import Experiment, load_experiment
from hil.log.topics import channels_of
from hil.log.write import MemorySink, PayloadWriter
from hil.rig.loop import Loop
from hil.runtime.virtual import run_virtual

Recorded: TypeAlias = tuple[Experiment, MemorySink, Loop]


def terminal(width: int = 110) -> Console:
    return Console(file=io.StringIO(), force_terminal=True, width=width, legacy_windows=False, _environ={"TERM": "xterm"})


def written(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


@pytest.fixture(scope="module")
def recorded() -> Recorded:
    experiment = load_experiment("dc-motor-hinf", ['duration="20 s"'])
    loop = compose(experiment, certify=False)
    sink = MemorySink(channels_of(loop))
    run_virtual(loop, 0, sink)
    sink.event(19_000_000_000, "late", "no control packet before the deadline", slot=380, severity="warning")
    return experiment, sink, loop


def feed(view: LiveView, sink: MemorySink, loop: Loop) -> Mapping[str, PayloadWriter]:
    """Hand the records over as a session does; return the receivers."""
    takers = view.begin(loop, channels_of(loop))
    for topic, payloads in sink.payloads.items():
        for t_ns, payload in zip(sink.times[topic], payloads):
            takers.get(topic, lambda *_: None)(t_ns, payload)
    return takers


def test_view_shows_progress_error_delays_lateness_and_events(recorded: Recorded) -> None:
    experiment, sink, loop = recorded
    console = terminal()
    view = LiveView(experiment, "real", link="can:hil:rig0", console=console)
    takers = feed(view, sink, loop)
    pack = channels_of(loop)["/timing/slot"].schema.pack
    for k in range(100):
        takers["/timing/slot"](k, pack(20.0 + k, 140.0, 60.0, k, int(k == 7), 0))
        view.render()  # what was counted is not counted again
    console.print(view.render())
    text = written(console)
    for part in ("dc-motor-hinf", "can:hil:rig0", "19.9", "of 20 s", "reference 3", "error", "τ = ", "d = "):
        assert part in text
    assert "p50 70 µs   p99 118 µs   max 119 µs" in text and "1 late, 0 overruns" in text and "no control packet" in text


def test_nothing_is_drawn_or_tapped_without_a_terminal(recorded: Recorded) -> None:
    experiment, sink, loop = recorded
    console = Console(file=io.StringIO(), force_terminal=False)
    with LiveView(experiment, "real", console=console) as view:
        assert feed(view, sink, loop) == {}
    assert written(console) == ""


def test_whom_the_rig_waits_for_is_said_when_the_run_begins(recorded: Recorded) -> None:
    experiment, sink, loop = recorded
    console = terminal()
    with LiveView(experiment, "real", waits="waiting for [you]\x1b", drawn=False, console=console) as view:
        assert written(console) == "" and feed(view, sink, loop) == {}
    assert written(console) == "waiting for [you]\\x1b\n"


def test_interrupt_restores_the_terminal(recorded: Recorded) -> None:
    experiment, sink, loop = recorded
    console = terminal()
    view = LiveView(experiment, "real", console=console)
    with pytest.raises(KeyboardInterrupt), view:
        feed(view, sink, loop)
        raise KeyboardInterrupt
    text = written(console)
    assert text.count("\x1b[?25l") == text.count("\x1b[?25h") == 1
    assert text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l")


def test_view_before_the_first_record_says_that_it_waits(recorded: Recorded) -> None:
    console = terminal()
    console.print(LiveView(recorded[0], "real", console=console).render())
    assert "starting" in written(console)


def test_view_says_how_long_a_design_or_a_proof_takes(recorded: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    console = terminal()
    view = LiveView(recorded[0], "virtual", console=console)
    now = console.get_time()
    monkeypatch.setattr(console, "get_time", lambda: now + 75.0)
    console.print(view.render())
    assert "computing … 75 s" in written(console)


def test_view_of_many_outputs_keeps_names_whole_and_one_line_each_at_sixty_columns() -> None:
    experiment = load_experiment("vtol-fault", ['duration="0.2 s"'])
    loop = compose(experiment, certify=False)
    sink = MemorySink(channels_of(loop))
    run_virtual(loop, 0, sink)
    pictures = {}
    for width in (40, 60, 110):
        console = terminal(width)
        view = LiveView(experiment, "real", console=console)
        takers = feed(view, sink, loop)
        takers["/timing/slot"](0, channels_of(loop)["/timing/slot"].schema.pack(20.0, 140.0, 60.0, 0, 0, 0))
        console.print(view.render())
        pictures[width] = Text.from_ansi(written(console)).plain.splitlines()
    heights = [len(lines) - next(i for i, line in enumerate(lines) if line.endswith(" of 0.2 s")) for lines in pictures.values()]
    assert len(set(heights)) == 1, heights
    for lines in (pictures[60], pictures[110]):
        for name in ("horizontal_velocity", "vertical_velocity"):
            assert next(line for line in lines if line.startswith(f"{name} ")).count("error") == 1
        mode = next(line for line in lines if line.startswith("detected_mode"))
        assert mode.split() == ["detected_mode", "1"], "a measured mode has neither reference nor error"
        assert not next(line for line in lines if line.startswith("input")).rstrip().endswith(" 1"), "a pure number has no unit"
