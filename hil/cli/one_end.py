"""``hil rig``, ``hil controller``, ``hil traffic``, ``hil discover``, ``hil keys``: one end of a loop, the other is elsewhere.

What else is on its bus; who is there; and keys and certificates that let one controller command, and no other.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from heapq import heapify, heapreplace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any, NoReturn

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.option_types import PATH, Duration, Questions
from hil.cli.run import run, session_options
from hil.cli.terminal import Working, answer, json_option, visible
from hil.errors import HilError, nearest

if TYPE_CHECKING:
    from can import BusABC

    from hil.experiment.nodes import TrafficTable
    from hil.runtime.real.controller_process import ControllerReport

NONE_THERE = 1  # exit status: neither rig nor controller


@click.command()
@click.argument("experiment", type=EXPERIMENT)
@session_options
@click.option("--wait", type=Duration(), help="How long to wait for a controller; until Ctrl-C by default.")
@json_option("Print the summary as one JSON object.")
@click.option("--quiet", is_flag=True, help="No live view.")
@click.pass_context
def rig(ctx: click.Context, /, experiment: str, wait: float | None, **options: object) -> None:
    """Run the rig of EXPERIMENT alone, in real time, and wait for a controller on the link.

    The controller is `hil controller EXPERIMENT` elsewhere, or a program of your own: hil new controller NAME --language python
    --for EXPERIMENT. It is `hil run --clock real --external` without a limit to the waiting.
    """
    from hil.rig.session_link import LONGEST_WAIT_S

    wait = LONGEST_WAIT_S if wait is None else wait
    ctx.invoke(run, experiment=experiment, clock="real", external=True, wait=wait, **options)


@click.command()
@click.argument("experiment", type=EXPERIMENT)
@click.option("--link", metavar="URI", help="Link to the rig; the experiment's own by default.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field.")
def controller(experiment: str, link: str | None, sets: tuple[str, ...]) -> None:
    """Answer sensor frames on a link with the controller of EXPERIMENT, until Ctrl-C.

    The rig is started elsewhere: hil rig EXPERIMENT --link URI.

    At its end it says what it counted, where frames came that were not of this rig, or not of their slot.

    Exit status: 1 a control law or link of your own raised, 2 bad input.
    """
    from hil.compose import compose
    from hil.experiment import load_experiment
    from hil.rig.session_link import link_of
    from hil.runtime.real.controller_process import serve
    from transport.links.zenoh_refusals import standard_output_is_free

    named = load_experiment(experiment, sets)
    with Working(f"{named.name}: its loop"):
        loop = compose(named)
    uri = link_of(loop.rig, link).uri
    standard_output_is_free()  # words go to standard error

    def say(text: str) -> None:
        print(f"hil: {visible(text)}", file=sys.stderr)

    def at_end(report: ControllerReport) -> None:
        if any(count for name, count in report.counts.items() if name not in ("sent", "received")):
            say(f"link {', '.join(f'{name} {count}' for name, count in report.counts.items() if count)}")

    begun = f"controller of {loop.experiment.name} on {uri}; Ctrl-C ends it"
    say(serve(loop, uri, opened=lambda: say(begun), at_end=at_end, warn=say))
    raise SystemExit(1)


@click.command()
@click.argument("file", type=PATH, metavar="TRAFFIC")
@click.argument("link", metavar="can:INTERFACE:CHANNEL")
@click.option("--without", multiple=True, metavar="NODE", help="Leave out the messages of this node: it is there itself.")
def traffic(file: Path, link: str, without: tuple[str, ...]) -> None:
    """Send the messages of a CAN bus's other nodes: hil traffic car.dbc can:socketcan:vcan0 --without Drive --without Bench

    TRAFFIC is a .dbc, whose messages with a cycle time (GenMsgCycleTime) are sent with the start values of their signals, or a
    .csv as of hil can analyse. So a controller under test has its bus around it. Runs until Ctrl-C, and says how many were sent.
    """
    from hil.rig.named_files import read_traffic
    from transport.links.python_can import bus_of

    found, _ = read_traffic(file, start_values=True)
    nodes = sorted({each.node for each in found})
    for name in without:
        if name not in nodes:
            raise HilError(f"--without: none of the messages of {file} is sent by {name!r} (its nodes: {', '.join(nodes)})")
    messages = [each for each in found if each.node not in without]
    if not messages:
        raise HilError(f"--without: nothing is left of {file}")

    with bus_of(link, fd=any(each.fd for each in messages)) as bus:
        _send_again_and_again(bus, messages, link)


def _send_again_and_again(bus: BusABC, messages: Sequence[TrafficTable], link: str) -> NoReturn:
    """Send each message in its period until an exception such as Ctrl-C's; one that is not due in time is sent when it can be."""
    from hil.runtime.clock import RealClock, monotonic_ns
    from transport.links.python_can import can

    due = [(round(each.offset * 1e9), number) for number, each in enumerate(messages)]
    heapify(due)
    clock, sent, lost = RealClock(monotonic_ns()), 0, 0
    print(f"{len(messages)} messages onto {visible(link)}; Ctrl-C ends it", flush=True)
    try:
        while True:
            at, number = due[0]
            clock.wait_until(at)
            each, now = messages[number], clock.now()
            if now < at:  # a signal came
                continue
            data = os.urandom(each.length) if each.data is None else bytes.fromhex(each.data)
            sent += 1  # before, as a signal comes behind: what others have received is counted
            try:
                bus.send(can.Message(
                    arbitration_id=each.can_id, is_extended_id=each.extended, is_fd=each.fd, bitrate_switch=each.fd, data=data,
                ))  # fmt: skip
            except (can.CanError, OSError):
                sent, lost = sent - 1, lost + 1
            period = max(round(each.period * 1e9), 1)
            heapreplace(due, (at + period * max(1, -((at - now) // period)), number))
    finally:
        print(f"{sent} frames sent, {lost} found no room", flush=True)


@click.command()
@click.argument("links", nargs=-1, metavar="[LINK]...")
@click.option("--wait", default="1s", show_default=True, type=Duration(0.1, 60), help="How long to wait for answers.")
@json_option("Print JSON instead of a table.")
def discover(links: tuple[str, ...], wait: float) -> None:
    """Say which rigs and controllers are on zenoh LINKs: by default on those of this user on this machine.

    LINK is zenoh:tcp/HOST:PORT and the like. A link with certificates or passwords answers its own ends alone.

    Exit status: 0 a rig or controller is there, 1 none, 2 bad input.
    """
    from transport.links.zenoh_observers import discover, endpoint_of, own_endpoints

    endpoints = [endpoint_of(link) for link in links] or own_endpoints()
    found = [found for endpoint in endpoints for found in discover(endpoint, wait)]
    answer(found, click.echo, "\n".join(map(_line, found)) or "no rig or controller found")
    if not found:
        raise SystemExit(NONE_THERE)


def _line(found: dict[str, Any]) -> str:
    about = found["info"]
    runs = "no answer about its session"
    if about:
        runs = f"{about['experiment']}, period {about['period_ns'] / 1e6:g} ms, session {about['session']}"
    return visible(f"{found['name']} at {found['endpoint']}: {' and '.join(found['alive'])}; {runs}")


@click.group(cls=Questions)
def keys() -> None:
    """Make keys and certificates for links that let only one controller command."""


@keys.command()
@click.argument("folder", type=PATH)
@click.option("--host", "hosts", multiple=True, help="Name or address of the rig besides localhost; several allowed.")
@click.option("--days", type=click.IntRange(1, 3650), default=365, show_default=True, help="How long the certificates are valid.")
def new(folder: Path, hosts: tuple[str, ...], days: int) -> None:
    """Make a test authority, certificates of rig and controller, and the key of the frames, in the new FOLDER."""
    from hil.files.keys import make_keys

    for path in make_keys(folder, hosts, days):
        print(visible(str(path)))
    print(f"zenoh:tls/127.0.0.1:7447?keys={visible(str(folder))}      certificates")
    print(f"can:hil:rig0?auth={visible(str(folder / 'frames.key'))}  a code in every frame, over any link")


@keys.command()
@click.argument("folder", type=PATH)
@click.option("--days", type=click.IntRange(1, 3650), default=365, show_default=True, help="How long the certificates are valid.")
def renew(folder: Path, days: int) -> None:
    """Make new certificates for the keys in FOLDER, which `hil keys new` made; it must hold ca.key. No private key changes."""
    from hil.files.keys import renew_certificates

    for path in renew_certificates(folder, days):
        print(visible(str(path)))


@keys.command()
@click.argument("folder", type=PATH)
@click.argument("name")
@click.option("--host", "hosts", multiple=True, help="Name or address of a rig of that name besides localhost; several allowed.")
@click.option("--days", type=click.IntRange(1, 3650), default=365, show_default=True, help="How long the certificate is valid.")
def issue(folder: Path, name: str, hosts: tuple[str, ...], days: int) -> None:
    """Make a private key and a certificate called NAME in FOLDER, which `hil keys new` made; it must hold ca.key."""
    from hil.files.keys import issue_certificate

    for path in issue_certificate(folder, name, hosts, days):
        print(visible(str(path)))
    print(f"zenoh:tls/127.0.0.1:7447?keys={visible(str(folder))}&controller={name}   or &rig={name}, at both ends")


@keys.command()
@click.argument("folder", type=PATH)
@click.argument("names", nargs=-1, required=True)
def revoke(folder: Path, names: tuple[str, ...]) -> None:
    """Revoke NAMES: write a list in FOLDER that both ends need beside their ca.pem. Links that are open stay open."""
    from hil.files.keys import revoke_names

    print(visible(str(revoke_names(folder, names))))
    known = [path.stem for path in folder.glob("*.pem")]
    for name in (each for each in names if each not in known):
        said = f"{folder} holds no certificate of {name!r}, which is on the list now{nearest(name, known)}"
        print(f"hil: {visible(said)}", file=sys.stderr)


@keys.command()
@click.argument("folder", type=PATH)
def signing(folder: Path) -> None:
    """Make a pair of keys that sign logs: FOLDER/signing.key is secret, FOLDER/signing.pub checks the signatures."""
    from hil.files.signature import make_signing_key

    key, public = (quote(visible(str(path))) for path in make_signing_key(folder))
    print(f"hil run EXPERIMENT --sign {key}      signs the log: keep this file")
    print(f"hil replay LOG --verify --key {public}   checks it: give this file away")
