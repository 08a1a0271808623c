"""``hil report``, ``hil recover``, ``hil export``, ``hil layout``, ``hil replay``: what is made of a log, and asked of it.

A replay says whether it was so, what another controller would have done, or puts it on a bus again.
"""

from __future__ import annotations

import sys
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING

import click

from hil.cli.option_types import PATH
from hil.cli.terminal import Working, answer, json_option, print_each_folded, print_folded, print_written, visible
from hil.errors import HilError

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from hil.log.run import Run


@click.command()
@click.argument("file", type=PATH)
@click.option("-o", "--output", type=PATH, metavar="PAGE.html", help="Page to write, FILE.html by default.")
@click.option("--figures", type=PATH, metavar="DIR", help="Also write every plot as SVG and PDF.")
@click.option("--folder", type=PATH, metavar="DIR", help="Folder of own modules, which are run.")
@click.option("--open", "show", is_flag=True, help="Open the page in the browser.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
def report(file: Path, output: Path | None, figures: Path | None, folder: Path | None, show: bool, force: bool) -> None:
    """Make one self-contained HTML page from the log FILE: it needs no network and no other file.

    Where FILE is a folder, its page (index.html) lists all its logs, with a filter and their outputs, or those of the folders
    below it where it has none, as `pytest --hil-logs` keeps them; each gets its own page, unless -o puts that of the folder
    elsewhere.

    A page that is there is replaced; the log is never changed.
    """
    from hil.api.face import report

    with Working(f"page of {file}") if folder is None else nullcontext():  # own modules are watched from a fork: one thread
        page, *drawn = report(file, output=output, force=force, figures=figures, folder=folder)
    click.echo(f"written: {visible(page)} ({page.stat().st_size / 1e6:.1f} MB)")
    if drawn and file.is_dir():
        click.echo(f"written: {len(drawn)} page{'s' * (len(drawn) != 1)} of runs beside it")
    if figures is not None:
        click.echo(f"written: {len(drawn) // 2} figures, as SVG and PDF, in {visible(figures)}")
    if show:
        click.launch(str(page))


@click.command()
@click.argument("file", type=PATH)
@click.option("-o", "--output", type=PATH, metavar="LOG.mcap", help="File to write [FILE.recovered.mcap].")
def recover(file: Path, output: Path | None) -> None:
    """Rebuild an indexed log from FILE, whose session was killed or whose disk was full.

    The command changes no existing file.
    """
    from hil.files import check_ending
    from hil.log.read.recover import recover

    target = output or Path(f"{str(file).removesuffix('.mcap')}.recovered.mcap")
    check_ending(target, "a log", ".mcap")
    with Working(f"records of {file}"):
        found = recover(file, target).text
    print_each_folded(found.splitlines())
    print_written(target)


@click.command()
@click.argument("file", type=PATH)
@click.option(
    "-o", "--output", type=PATH, required=True, help="Ends in .log, .blf, .asc, .trc, .mf4, .csv, .npz or .mat."
)
@click.option("--topic", "topics", multiple=True, metavar="TOPIC", help="Only this topic; may be given more than once.")
@click.option("--force", is_flag=True, help="Replace files that are there.")
def export(file: Path, output: Path, topics: tuple[str, ...], force: bool) -> None:
    """Write the log FILE as a CAN log (candump .log, Vector .blf or .asc, PEAK .trc, ASAM .mf4) or as tables (.csv, .npz, .mat).

    Frames stand at their measured times, tables have session times. Tables of more than one topic become files named
    OUTPUT.topic.csv. A run with an emulated CAN bus gives the frames of that bus: the log has their times and lengths, their
    bytes are 00; --topic /link/sensor and --topic /link/control give those of the link.
    """
    from hil.files import check_output
    from hil.log.read import read_run
    from hil.log.read.export import export

    check_output(output, force=force)
    with Working(f"export of {file}"):
        written = list(export(read_run(file), output, topics, replace=force))
    for path in written:
        print(visible(path))


@click.command()
@click.argument("viewer", type=click.Choice(["foxglove", "lichtblick", "plotjuggler"]))
@click.argument("source", metavar="SOURCE")
@click.option("-o", "--output", type=PATH, metavar="FILE", help="File to write; by default it is printed.")
@click.option("--force", is_flag=True, help="Replace a file that is there.")
def layout(viewer: str, source: str, output: Path | None, force: bool) -> None:
    """Make a layout for the logs of SOURCE, an experiment or a log: outputs, states, inputs, delays, timing and events.

    Foxglove and Lichtblick import the JSON under "Import from file", PlotJuggler loads the XML by "Layout".
    """
    from hil.compose import compose
    from hil.experiment import load_experiment
    from hil.files import check_output, write_output
    from hil.log.read import read_run
    from hil.log.topics import channels_of, panels
    from hil.pages.viewers import foxglove, plotjuggler

    check_output(output, "a layout", ".xml" if viewer == "plotjuggler" else ".json", force=force)
    if Path(source).suffix == ".mcap":
        schemas = read_run(source).schemas
    else:
        loop = compose(load_experiment(source), certify=False)
        schemas = {topic: channel.schema for topic, channel in channels_of(loop).items()}
    if not panels(schemas):
        raise HilError(f"{source}: none of its topics is plotted over time; expected an experiment, or the log of a run")
    text = plotjuggler(schemas) if viewer == "plotjuggler" else foxglove(schemas) + "\n"
    if output is None:
        click.echo(text, nl=False)
    else:
        write_output(output, text, replace=force)
        print_written(output)


ROWS = 1 << 15  # that are written at a time
SLOWEST = 1e-6  # of --onto: below it a second takes eleven days


@click.command()
@click.argument("file", type=PATH)
@click.option("--verify", "do_verify", is_flag=True, help="Re-run controller and plant; compare every record.")
@click.option("--key", type=PATH, metavar="PUB", help="With --verify: who signed the log (signing.pub).")
@click.option("--auth", type=PATH, metavar="KEY", help="With --verify: check all tags (frames.key).")
@click.option("--controller", metavar="NAME", help="What would this controller have commanded?")
@click.option("--parameter", "sets", multiple=True, metavar="KEY=VALUE", help="A parameter of --controller; repeatable.")
@click.option("--onto", metavar="URI", help="Put the recorded frames on this link.")
@click.option("--process", metavar="URI", help="Send its sensor packets to the controller's process there; compare the answers.")
@click.option("--speed", type=float, default=1.0, show_default=True, help="With --onto: how many times faster.")
@click.option("--folder", metavar="DIR", help="Where the files stand that the experiment names (own modules, an FMU).")
@click.option("-o", "--output", type=PATH, metavar="FILE.csv", help="With --controller: write the series.")
@json_option()
def replay(
    file: Path, do_verify: bool, key: Path | None, auth: Path | None, controller: str | None, sets: tuple[str, ...],
    onto: str | None, process: str | None, speed: float, folder: str | None, output: Path | None,
) -> None:  # fmt: skip
    """Replay the log FILE. Without an option: --verify.

    It says "same bits", "same within 1e-9" (a log of another machine, where something is not exact), or "different", with
    the first sample that differs, and the SHA-256 of the records: of one experiment and seed in virtual time the same on
    every machine.

    With --process the running program of a controller gets every recorded sensor packet again; each field of its answers that
    differs from the log is one line, except their time and counter.

    Exit status: 0; 1 if --verify or --process finds it different, an answer lacks the tag of --auth, or the log is not what
    the holder of --key signed; 2 bad input.
    """
    from hil.files import check_output
    from hil.log.read import read_run

    ways = {"--verify": do_verify, "--controller": controller is not None, "--onto": onto is not None,
            "--process": process is not None}  # fmt: skip
    chosen = [name for name, given in ways.items() if given]
    if len(chosen) > 1:
        raise HilError(f"{' and '.join(chosen)}: choose one")
    if not SLOWEST <= speed < float("inf"):
        raise HilError(f"--speed: {speed}; expected a number of at least {SLOWEST:g}")
    companions = (("--parameter", sets, "--controller"), ("-o", output, "--controller"), ("--speed", speed != 1, "--onto"),
                  ("--key", key, "--verify"), ("--auth", auth, "--verify"))  # fmt: skip
    for name, given, needed in companions:
        if given and needed not in (chosen or ["--verify"]):
            raise HilError(f"{name}: needs {needed}")
    check_output(output, "a table", ".csv", remedy="choose another -o")
    if key is None:
        with Working(f"records of {file}"):
            run = read_run(file)
    else:
        run = _signed(file, key)
    if controller is not None:
        _what_if(run, file, folder, controller, sets, output)
    elif onto is not None:
        _onto(run, onto, speed)
    elif process is not None:
        _ask(run, file, process)
    else:
        _verify(run, file, folder, auth)


def _ask(run: Run, file: Path, uri: str) -> None:
    from msgspec import to_builtins

    from hil.session.replay.over_link import ask_process

    with Working(f"sensor packets to {uri}"):
        done = ask_process(run, uri, str(file))
    lines = (*map(visible, done.differences), f"{done.different} of {done.compared} answers differ")
    answer(to_builtins(done), lambda: print(*lines, sep="\n"))
    sys.exit(1 if done.different else 0)


def _signed(file: Path, key: Path) -> Run:
    """Return the log, read from the very file whose signature was checked."""
    from hil.files import open_regular
    from hil.files.signature import BadSignature, check_signature
    from hil.log.read import read_run

    with open_regular(file, "a log") as log:
        try:
            named = check_signature(file, key, log)
        except BadSignature as error:
            print(f"hil: {visible(str(error))}", file=sys.stderr)
            sys.exit(1)
        print(f"signed with {visible(str(key))} ({named})", file=sys.stderr)
        return read_run(file, descriptor=log.fileno())


def _verify(run: Run, file: Path, folder: str | None, auth: Path | None) -> None:
    from msgspec.structs import asdict

    from hil.log.run import records_sha256
    from hil.session.replay.recorded import verify_tags
    from hil.session.replay.replay import changed_files, experiment_of, verify

    experiment = experiment_of(run, str(file), folder=folder)
    for sentence in changed_files(run, experiment):
        print(f"hil: {visible(sentence)}", file=sys.stderr)
    with Working(f"{file} again"):
        tags = None if auth is None else verify_tags(run, auth, str(file))
        verdict = verify(run, str(file), experiment)
        sha256 = records_sha256(run)
    alike = f"{verdict.likeness}: {verdict.answers} control packets, {verdict.states} plant states"
    lines = [alike if verdict.likeness != "different" else f"different: {verdict.difference}"]
    if verdict.likeness == "same within 1e-9":
        lines.append(f"first other bits: {verdict.difference}")
    if tags is not None:
        wrong = f"; {tags.wrong} have not the key's, the first in slot {tags.first}" if tags.wrong else ""
        lines.append(f"tags: {tags.verified} verified{wrong}")
    said = {"likeness": verdict.likeness, "identical": verdict.difference is None, "difference": verdict.difference,
            "answers": verdict.answers, "states": verdict.states, **({} if tags is None else {"tags": asdict(tags)}),
            "records_sha256": sha256}  # fmt: skip
    answer(said, lambda: print(*lines, f"records: SHA-256 {sha256}", sep="\n"))
    sys.exit(1 if verdict.likeness == "different" or (tags is not None and tags.wrong) else 0)


def _what_if(run: Run, file: Path, folder: str | None, kind: str, sets: tuple[str, ...], output: Path | None) -> None:
    import numpy as np

    from hil.experiment import parse_plugin
    from hil.session.replay.replay import experiment_of, what_if

    experiment = experiment_of(run, str(file), folder=folder)
    asked = parse_plugin("hil.controllers", kind, sets)
    with Working(f"answers of {kind}"):
        series = what_if(run, asked, kind, str(file), experiment)
    names = [name.removeprefix("recorded_") for name in series if name.startswith("recorded_")]
    differences = {}
    for name in names:
        gap = series[f"{kind}_{name}"] - series[f"recorded_{name}"]
        differences[name] = {
            "rms": float(np.sqrt(np.nanmean(gap**2))),
            "max": float(np.nanmax(np.abs(gap))),
            "max_abs_recorded": float(np.nanmax(np.abs(series[f"recorded_{name}"]))),
            "max_abs_replayed": float(np.nanmax(np.abs(series[f"{kind}_{name}"]))),
        }
    if output is not None:
        _write_series(output, series)
    said = {"controller": kind, "inputs": differences, "output": str(output) if output else None}
    answer(said, _show_differences, run, kind, differences, output)


def _show_differences(run: Run, kind: str, differences: dict[str, dict[str, float]], output: Path | None) -> None:
    from hil.log.topics import APPLIED

    units = {field.name: field.unit for field in run.schemas[APPLIED.name].fields}
    for name, d in differences.items():
        u = f" {units.get(name, '')}".rstrip()
        print_folded(
            f"{name}: {kind} would have differed by {d['rms']:.4g}{u} rms, {d['max']:.4g}{u} at most "
            f"(largest command {d['max_abs_replayed']:.4g}{u}, recorded {d['max_abs_recorded']:.4g}{u})"
        )
    print(f"written: {visible(output)}" if output else "the plant does not react to it; -o FILE.csv writes the series")


def _write_series(output: Path, series: dict[str, npt.NDArray[np.float64]]) -> None:
    """Write columns as CSV, a piece at a time."""
    import numpy as np

    from hil.files import written_whole

    with written_whole(output, replace=False) as part, open(part, "w", encoding="utf-8") as file:
        file.write(",".join(series) + "\n")
        for start in range(0, len(series["t_s"]), ROWS):
            rows = np.column_stack([column[start : start + ROWS] for column in series.values()])
            np.savetxt(file, rows, delimiter=",", fmt="%.9g")


def _onto(run: Run, uri: str, speed: float) -> None:
    from hil.session.replay.over_link import onto

    with Working(f"onto {uri}") as watch:
        done = onto(run, uri, speed, watch.counted)
    error = ", ".join(f"{name} {value:.0f}" for name, value in done.error_us.items() if value is not None)
    words = f"{done.frames} frames on {uri} at {speed:g} times the recorded speed; own timing error in us: {error}"
    answer({"frames": done.frames, "speed": speed, "timing_error_us": done.error_us}, print, words)
