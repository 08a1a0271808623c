"""``hil rig``, ``hil controller``, ``hil discover``: one end of a loop whose other end runs elsewhere, and who is there."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.option_types import Duration
from hil.cli.terminal import Working, json_option, print_json, visible

NONE_THERE = 1  # exit status: neither rig nor controller


@click.command()
@click.argument("experiment", type=EXPERIMENT)
@click.option("--link", metavar="URI", help="Link to the controller; the experiment's own by default.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field, such as plant.gain=170.")
@click.option("--seed", type=int, help="Seed of the run; the experiment's own by default.")
@click.option("--duration", type=str, metavar="S", help="Length of the run: 10, 10s, 2min.")
@click.option("-o", "--output", type=click.Path(path_type=Path), metavar="FILE.mcap", help="Log; by default below runs/.")
@click.option("--force", is_flag=True, help="Replace the file of -o.")
@click.option("--wait", type=Duration(), help="How long to wait for a controller; until Ctrl-C by default.")
@json_option("Print the summary as one JSON object.")
@click.option("--quiet", is_flag=True, help="No live view.")
@click.pass_context
def rig(ctx: click.Context, /, experiment: str, wait: float | None, **options: object) -> None:
    """Run the rig of EXPERIMENT alone, in real time, and wait for a controller on the link.

    The controller is `hil controller EXPERIMENT` elsewhere, or a program of your own: hil new controller NAME --language python
    --for EXPERIMENT. The same as `hil run --clock real --external` with all the time that it takes.
    """
    from hil.cli.run import LONGEST_WAIT_S, command

    wait = LONGEST_WAIT_S if wait is None else wait
    ctx.invoke(command, experiment=experiment, clock="real", external=True, wait=wait, **options)


@click.command()
@click.argument("experiment", type=EXPERIMENT)
@click.option("--link", metavar="URI", help="Link to the rig; the experiment's own by default.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field.")
def controller(experiment: str, link: str | None, sets: tuple[str, ...]) -> None:
    """Answer sensor frames on a link with the controller of EXPERIMENT, until Ctrl-C.

    The rig is started elsewhere: hil rig EXPERIMENT --link URI.
    """
    from hil.compose.loop import compose
    from hil.experiment import load_experiment
    from hil.rig.session_link import link_of
    from hil.runtime.real.controller_process import serve
    from transport.links.opening import find_link
    from transport.links.zenoh_refusals import standard_output_is_free

    named = load_experiment(experiment, sets)
    with Working(f"{named.name}: its loop"):
        loop = compose(named)
    uri = link_of(loop.rig, link).uri
    find_link(uri)  # what cannot be a link is said first
    print(f"hil: controller of {loop.experiment.name} on {uri}; Ctrl-C ends it", file=sys.stderr)
    standard_output_is_free()  # words go to standard error
    serve(loop, uri)


@click.command()
@click.argument("links", nargs=-1, metavar="[LINK]...")
@click.option("--wait", default="1s", show_default=True, type=Duration(0.1, 60), help="How long to wait for answers.")
@json_option("Print JSON instead of a table.")
def discover(links: tuple[str, ...], wait: float, as_json: bool) -> None:
    """Say which rigs and controllers are on zenoh LINKs: by default on those of this user on this machine.

    LINK is zenoh:tcp/HOST:PORT and the like. A link with certificates or passwords answers its own ends alone.

    Exit status: 0 a rig or controller is there, 1 none, 2 bad input.
    """
    from transport.links.zenoh_observers import discover, endpoint_of, own_endpoints

    endpoints = [endpoint_of(link) for link in links] or own_endpoints()
    found = [found for endpoint in endpoints for found in discover(endpoint, wait)]
    if as_json:
        print_json(found)
    else:
        click.echo("\n".join(map(_line, found)) or "no rig or controller found")
    if not found:
        raise SystemExit(NONE_THERE)


def _line(found: dict[str, Any]) -> str:
    about = found["info"]
    runs = "no answer about its session"
    if about:
        runs = f"{about['experiment']}, period {about['period_ns'] / 1e6:g} ms, session {about['session']}"
    return visible(f"{found['name']} at {found['endpoint']}: {' and '.join(found['alive'])}; {runs}")
