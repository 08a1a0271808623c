"""``hil can``, ``hil dbc``, ``hil vcan``: response times on a CAN bus, a bridge to it, its frames for other tools, a vcan0."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from msgspec import to_builtins

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.option_types import OUTPUT, PATH, Duration, NamedPath, Questions
from hil.cli.page_text import show_page
from hil.cli.terminal import json_option, visible
from hil.errors import HilError, located

if TYPE_CHECKING:
    from can import Message

    from hil.design_questions.bus_analysis import BusAnalysis
    from transport.can_analysis import ErrorBursts

_TRAFFIC = (".csv", ".dbc")
_CODEC = "hilrig"
NOT_THERE = 127
"""Status of a command that is not there, as a shell's."""


@click.group(cls=Questions)
def can() -> None:
    """Questions about CAN buses."""


@can.command()
@click.argument("target", type=EXPERIMENT, metavar="TRAFFIC|EXPERIMENT")
@click.option("--bitrate", metavar="RATE", help="Nominal bit rate of TRAFFIC, as 500k or 500000.")
@click.option("--dbitrate", metavar="RATE", help="Data bit rate of TRAFFIC, as 2M.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field of EXPERIMENT.")
@click.option("--duration", type=Duration(above=True, most=3600.0), default="10", show_default=True, help="How long to simulate.")
@click.option("--errors", type=click.IntRange(1), help="Errors that may come at once; the bounds allow for them.")
@click.option("--error-interval", type=Duration(1e-9), help="--errors: time between further errors; 1 s by default.")
@click.option("-o", "--output", type=OUTPUT, metavar="PAGE.html", help="Write a page here.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
@json_option()
def analyse(
    target: str, bitrate: str | None, dbitrate: str | None, sets: tuple[str, ...], duration: float, errors: int | None,
    error_interval: float | None, output: Path | None, force: bool,
) -> None:  # fmt: skip
    """Show bound, measured response and deadline of every message: hil can analyse car.dbc --bitrate 500k

    TRAFFIC is a table of messages, .csv or .dbc; an EXPERIMENT has a medium of kind can. The exit status is 0 also where a
    message may miss its deadline.
    """
    from hil.experiment import load_experiment
    from hil.files import check_page
    from hil.files.can_logs import CAN_LOG_ENDINGS
    from hil.pages.designs import bus_page
    from transport.can_analysis import ErrorBursts

    check_page(output, force=force)
    if errors is None and error_interval is not None:
        raise HilError("--error-interval: only with --errors, how many may come at once")
    bursts = None if errors is None else ErrorBursts(burst=errors, interval_ns=round((error_interval or 1.0) * 1e9))
    if target.endswith(CAN_LOG_ENDINGS):
        raise HilError(f"{target}: recorded frames have no period, and no bound follows from them; expected a .csv or .dbc")
    if target.endswith(_TRAFFIC):
        if sets:
            raise HilError(f"--set: {target} is no experiment")
        found = _of_traffic(Path(target), bitrate, dbitrate, duration, bursts)
    else:
        if bitrate is not None or dbitrate is not None:
            load_experiment(target)  # what is none has a message of its own
            raise HilError(f"--bitrate: is for messages in a .csv or .dbc; change that of {target} by --set "
                           "network.media.NAME.bitrate=500000")  # fmt: skip
        found = _of_experiment(target, sets, duration, bursts)
    show_page(bus_page(found), to_builtins(found), output)


@can.command()
@click.argument("channel")
@click.argument("interface")
@click.option("--bitrate", required=True, metavar="RATE", help="Nominal bit rate of CHANNEL, as 500k or 500000.")
@click.option("--dbitrate", metavar="RATE", help="Data bit rate, as 2M; without it INTERFACE carries classic frames alone.")
@click.option("--restart-ms", type=click.IntRange(0, 1_000_000), default=0, show_default=True, metavar="MS",
              help="From bus-off to when recovery begins; 0: it stays off.")  # fmt: skip
@click.option("--berr-reporting/--no-berr-reporting", default=True, show_default=True,
              help="An error frame for every destroyed frame, beside those of state changes.")  # fmt: skip
def bridge(channel: str, interface: str, bitrate: str, dbitrate: str | None, restart_ms: int, berr_reporting: bool) -> None:
    """Act as CAN controller between a SocketCAN interface and a bus with time: hil can bridge rig0 vcan0 --bitrate 500k

    What programs send on INTERFACE, such as vcan0, goes onto the bus CHANNEL (can:hil:CHANNEL?timed=1) in its turn; what others
    send there, and the error frames of this controller, come onto INTERFACE. Runs until Ctrl-C, or INTERFACE is gone.
    """
    from transport.links.can_bus import HilBus, bridge
    from transport.links.python_can import can

    flexible = dbitrate is not None
    try:
        with HilBus(
            channel, fd=flexible, timed=True, bitrate=bitrate, dbitrate=dbitrate, restart_ms=restart_ms,
            berr_reporting=berr_reporting,
        ) as bus, can.Bus(interface, interface="socketcan", fd=flexible, ignore_config=True) as beside:  # fmt: skip
            said = f"its error frames: candump -e {interface},0:0,#FFFFFFFF"
            print(f"{interface} is a node of the bus {channel}; {said}", flush=True)
            bridge(bus, beside)
    except (can.CanError, OSError) as error:
        if str(error).startswith("hil:"):
            raise HilError(str(error).removeprefix("hil: ")) from error
        raise HilError(f"interface {interface!r}: {error}; is it there and up? `hil vcan -- COMMAND` has a vcan0") from error


def _of_traffic(path: Path, bitrate: str | None, dbitrate: str | None, seconds: float, errors: ErrorBursts | None) -> BusAnalysis:
    from hil.design_questions.bus_analysis import analyse_traffic
    from hil.rig.named_files import read_traffic
    from hil.runtime.nodes import rng_for
    from transport.can_bus_model import BitRates
    from transport.errors import FieldError
    from transport.links.can_open import rate

    try:
        traffic, others = read_traffic(path)
        if bitrate is None:
            raise HilError(f"--bitrate: missing; {path} says no bit rate, such as 500k")
        rates = BitRates(rate(bitrate, "bitrate"), None if dbitrate is None else rate(dbitrate, "dbitrate"))
        if rates.dbitrate is None and any(each.fd for each in traffic):
            raise HilError(f"--dbitrate: missing; {path} has CAN FD messages")
        found = analyse_traffic(path.name, traffic, rates, seconds, partial(rng_for, 0), errors)
        if others:
            named = f"{len(others)}: {', '.join(others[:3])}" + ", ..." * (len(others) > 3)
            found = replace(found, assumes=f"{found.assumes}, and nothing without GenMsgCycleTime is sent ({named})")
        return found
    except FieldError as error:
        raise HilError(f"{path if error.field == 'identifier' else '--' + error.field}: {error.message}") from error


def _of_experiment(target: str, sets: tuple[str, ...], seconds: float, errors: ErrorBursts | None) -> BusAnalysis:
    from hil.compose import compose
    from hil.design_questions.bus_analysis import analyse
    from hil.experiment import load_experiment
    from hil.measure.bus_load import bus_of
    from hil.measure.view import view_of
    from hil.rig.can_bus import analysed, can_bus_of, is_disturbed, rates_of
    from hil.runtime.virtual import simulate

    experiment = load_experiment(target, sets, duration=str(seconds))
    loop = compose(experiment, certify=False)
    bus = can_bus_of(loop.rig)
    if bus is None:
        raise HilError(f"{experiment.name}: no medium of kind 'can', see hil guide can-bus")
    if bus.table.recorded:
        raise HilError(f"{experiment.name}: recorded frames have no period, and no bound follows from them; hil run measures")
    measured = bus_of(view_of(simulate(loop, experiment.seed), loop.experiment))
    worst = {} if measured is None else {(each.extended, each.can_id): each.response_worst_ms for each in measured.messages}
    messages, disturbed = analysed(loop.rig, bus, loop.rows), is_disturbed(bus.table, experiment.fault)
    return analyse(experiment.name, messages, rates_of(bus.table), worst, seconds, errors, disturbed=disturbed)


@click.command()
@click.argument("experiment", type=EXPERIMENT, required=False)
@click.option("--link", metavar="URI", help="Framing and base of another link than EXPERIMENT's own.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field of EXPERIMENT.")
@click.option("--c", "folder", type=PATH, metavar="DIR", help="Write a C codec here: hilrig.h, hilrig.c.")
@click.option("--decode", "log", type=PATH, metavar="FILE", help="Decode a CAN log: .log, .asc or .blf.")
@click.option("--force", is_flag=True, help="Replace files that are there.")
def dbc(
    experiment: str | None, link: str | None, sets: tuple[str, ...], folder: Path | None, log: Path | None, force: bool
) -> None:
    """Print the DBC of the link's frames; of EXPERIMENT with a message for each sensor node, and each value by its name.

    With --c write a C codec that cantools makes of it, for a controller on another machine; with --decode print what the
    frames of a CAN log say, one JSON object a line.
    """
    if experiment is None and (link is not None or sets):
        raise HilError("--link and --set: name an experiment; without one the DBC is that of any one node below 0x100")
    if folder is not None and log is not None:
        raise HilError("--c and --decode: one at a time")
    text = _text(experiment, link, sets)
    if folder is not None:
        _write_codec(database_of(text), folder, force)
    elif log is not None:
        _decode(database_of(text), log)
    else:
        print(text, end="")


def _text(experiment: str | None, link: str | None, sets: tuple[str, ...]) -> str:
    from hil.experiment import load_experiment
    from hil.rig import rig_of
    from hil.rig.session_link import rig_dbc
    from transport import dbc_path
    from transport.links import TransportError

    if experiment is None:
        return dbc_path().read_text(encoding="utf-8")
    with located(experiment, TransportError, ValueError):
        return rig_dbc(rig_of(load_experiment(experiment, sets)), link)


def c_codec(database: Any) -> tuple[str, str]:
    """Return header and source of the codec in C that cantools makes of a database: hilrig.h and hilrig.c, today as tomorrow."""
    from cantools.database.can.c_source import generate

    texts = generate(database, _CODEC, f"{_CODEC}.h", f"{_CODEC}.c", "")[:2]
    header, source = (re.sub(r"(generated by cantools version \S+) .*", r"\1.", text) for text in texts)
    return header, source


def _write_codec(database: Any, folder: Path, force: bool) -> None:
    from hil.files import check_output, made_folder, write_output

    paths = [made_folder(folder) / f"{_CODEC}.{ending}" for ending in ("h", "c")]
    for path in paths:
        check_output(path, force=force)
    for path, text in zip(paths, c_codec(database)):
        write_output(path, text, replace=force)
        print(visible(path))


def _decode(database: Any, log: Path) -> None:
    from cantools.database import DecodeError

    from hil.files.can_logs import can_frames
    from hil.log import plain

    found = foreign = 0
    for frame in can_frames(log):
        try:
            message = database.get_message_by_frame_id(frame.arbitration_id)
        except KeyError:
            continue  # another node's
        if _is_foreign(frame, message.length, "Crc" in message.signal_tree):
            foreign += 1
            continue
        try:
            signals = message.decode(bytes(frame.data), decode_choices=True, allow_truncated=True)
        except (DecodeError, ValueError) as e:
            raise HilError(f"{log}: a frame {frame.arbitration_id:#x} is none of {message.name}: {e}") from e
        print(json.dumps(plain({"t_s": round(frame.timestamp, 9), "frame": message.name, **signals})))
        found += 1
    if foreign:
        print(f"hil: {visible(str(log))}: {foreign} frames have an identifier of this DBC and are of no packet", file=sys.stderr)
    if not found:
        raise HilError(f"{log}: no frame is of a packet of this DBC; hil dbc EXPERIMENT --link URI --decode knows other ones")


def _is_foreign(frame: Message, length: int, first: bool) -> bool:
    """Return whether a frame with an identifier of ours is of no packet, as far as one frame shows.

    Args:
        frame: of a log.
        length: of our frames, bytes.
        first: whether a packet begins in it.
    """
    from transport.packets import decode, packet_size
    from transport.wire import sensor_length

    odd = frame.is_extended_id or frame.is_remote_frame or frame.is_error_frame
    if odd or not first:
        return odd
    data = bytes(frame.data)
    size = packet_size(data)
    whole = size is not None and size <= len(data)
    return len(data) < min(length, sensor_length(0)) or size == 0 or (whole and decode(data[:size]) is None)


def database_of(text: str) -> Any:
    """Return the database of a DBC, as cantools reads it."""
    import cantools

    return cantools.database.load_string(text, "dbc")


@click.command(context_settings={"allow_interspersed_args": False})
@click.option("--backend", type=click.Choice(["auto", "native", "uml", "debian"]), default="auto", show_default=True,
              help="This kernel's vcan, our user-mode kernel, or Debian's package of one.")  # fmt: skip
@click.option("--virtual-time", is_flag=True, help="The clock jumps to the next timer when all sleep (uml only).")
@click.option("--timeout", type=Duration(above=True), help="End COMMAND after that time, such as 90s.")
@click.option("--rw", multiple=True, metavar="DIR", type=NamedPath(exists=True, file_okay=False, path_type=Path),
              help="One more directory in which files stay.")  # fmt: skip
@click.option("--source", metavar="FILE", type=NamedPath(dir_okay=False, path_type=Path),
              help="Archive linux-6.12*.tar.xz to build the kernel from, in place of Debian's package.")  # fmt: skip
@click.option("--install", is_flag=True, help="Install the Debian packages that a build lacks (as root).")
@click.option("-v", "--verbose", is_flag=True, help="Say which kernel is used.")
@click.argument("argv", metavar="[--] COMMAND [ARG]...", nargs=-1, required=True, type=click.UNPROCESSED)
def vcan(
    backend: str, virtual_time: bool, timeout: float | None, rw: tuple[Path, ...], source: Path | None, install: bool,
    verbose: bool, argv: tuple[str, ...],
) -> None:  # fmt: skip
    """Run COMMAND where a real vcan0 exists, and exit with its status.

    Where this kernel has CAN, COMMAND has a network of its own with a vcan0 in it, and all else is unchanged. Elsewhere, as in
    most containers, a small user-mode kernel is booted on this machine's own files (0.3 s). It is built once (some minutes) and
    kept in ~/.cache/hilrig. There, what COMMAND writes is lost, except in this directory and those of --rw; /tmp is
    empty, HOME is another one, and only vcan0 and lo are networks. With --virtual-time computing takes no time: no deadline
    is missed however slow the machine is, and two runs give the same time stamps.

    \b
    Exit status: that of COMMAND (128 + N if signal N ended it)
      124  ended by --timeout
      125  no vcan0 is available
      126, 127  COMMAND cannot be run, or is not there
    """
    from hil.vcan import RUNNER_FAILED, RunnerError, Wanted, run_beside_vcan
    from hil.vcan.supervise import say

    if virtual_time and backend not in ("auto", "uml"):
        raise click.UsageError(f"--backend {backend} has no virtual time")
    if source is not None and not source.is_file():
        raise click.BadParameter(f"there is no file {visible(source)}", param_hint="--source")
    if shutil.which(argv[0]) is None and not os.path.lexists(argv[0]):  # now, and not behind the build of a kernel
        say(f"there is no command {visible(argv[0])}")
        sys.exit(NOT_THERE)
    wanted = Wanted(
        command=argv,
        backend=backend,
        virtual_time=virtual_time,
        writable=tuple(os.path.abspath(place) for place in (Path(), *rw)),
        source=None if source is None else source.absolute(),
        install=install,
        verbose=verbose,
    )
    try:
        status = run_beside_vcan(wanted, timeout)
    except RunnerError as why:
        say(str(why))
        status = RUNNER_FAILED
    sys.exit(status)
