"""``hil discover``: which rigs and controllers are there on zenoh links, and what runs on them."""

from __future__ import annotations

from typing import Any

import click

from hil.cli.option_types import Duration
from hil.cli.terminal import json_option, print_json, visible

NONE_THERE = 1  # exit status: neither rig nor controller


@click.command()
@click.argument("links", nargs=-1, metavar="[LINK]...")
@click.option("--wait", default="1s", show_default=True, type=Duration(0.1, 60), help="How long to wait for answers.")
@json_option("Print JSON instead of a table.")
def command(links: tuple[str, ...], wait: float, as_json: bool) -> None:
    """Say which rigs and controllers are on zenoh LINKs: by default on those of this user on this machine.

    LINK is zenoh:tcp/HOST:PORT and the like. A link with certificates or passwords answers its own ends alone.

    Exit status: 0 a rig or controller is there, 1 none, 2 bad input.
    """
    from transport.links.zenoh_discover import discover, endpoint_of, own_endpoints

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
