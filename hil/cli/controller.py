"""``hil controller``: only the controller of an experiment, for a rig that runs elsewhere."""

from __future__ import annotations

import sys

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.terminal import Working


@click.command()
@click.argument("experiment", type=EXPERIMENT)
@click.option("--link", metavar="URI", help="Link to the rig; the experiment's own by default.")
@click.option("--set", "sets", type=CHANGE, multiple=True, metavar="PATH=VALUE", help="Change a field.")
def command(experiment: str, link: str | None, sets: tuple[str, ...]) -> None:
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
