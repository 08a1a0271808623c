"""``hil identify rates``: how often a fault comes and goes, and how fast it is detected, from logs."""

from __future__ import annotations

from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.option_types import Duration
from hil.cli.terminal import json_option, print_json
from hil.errors import HilError

if TYPE_CHECKING:
    from design.identification.jump_rates import JumpRate


@click.command()
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--edge", "edges", multiple=True, type=Duration(above=True),
              help="Sojourn at which the rate may change, such as 0.3s; repeatable.")  # fmt: skip
@click.option("--fault", default="fault_mode", show_default=True, metavar="NAME", help="State that is the true mode.")
@click.option("--detected", default="detected_mode", show_default=True, metavar="NAME", help="State that is the detected mode.")
@json_option()
def rates(logs: tuple[Path, ...], edges: tuple[float, ...], fault: str, detected: str, as_json: bool) -> None:
    """Estimate the rates of a fault and of its detection (4.2) from one or more LOGs of a plant that logs both modes.

    Jumps are counted over the time in which they could come, apart for every true mode; intervals are at 95 %.
    """
    from design.errors import DesignError
    from design.identification.jump_rates import jump_rates
    from hil.cli.terminal import Working
    from hil.measure.mode_record import read_mode_record

    with Working("modes of the logs"):
        read = [read_mode_record(path, (fault, detected)) for path in logs]
    if len({restarts for _, restarts in read}) > 1:
        raise HilError("logs of different plants: failure_restarts_detection_clock is true in some and false in others")
    try:
        found = jump_rates([record for record, _ in read], edges, restarts=read[0][1])
    except DesignError as error:
        raise HilError(f"identify: {error}") from error
    if as_json:
        print_json({"logs": [str(path) for path in logs], "rates": [_plain(each) for each in found]})
        return
    for each in found:
        what = "fault" if each.fault is None else f"detected, fault {each.fault}"
        until = f"{each.before_s:g}" if isfinite(each.before_s) else "..."
        click.echo(
            f"{what:>18}  {each.source} -> {each.to}  h {each.after_s:g} to {until} s: {each.rate:.4g} 1/s, "
            f"95 %: {each.low:.4g} to {each.high:.4g} ({each.jumps} jumps in {each.exposure_s:.4g} s)"
        )


def _plain(each: JumpRate) -> dict[str, Any]:
    return each._asdict() | {"before_s": each.before_s if isfinite(each.before_s) else None}
