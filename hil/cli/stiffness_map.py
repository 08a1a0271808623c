"""``hil stiffness-map``: how stiff a wall may be over rate, delay and hand damping, certified."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict
from pathlib import Path

import click

from hil.cli.option_types import NumberList
from hil.cli.terminal import Working, json_option, show_page
from hil.errors import HilError


@click.command()
@click.option("--period", type=NumberList(above=True, times=True), default="1ms,50ms", show_default=True, help="Sample periods.")
@click.option("--delay", type=NumberList(whole=True), default="0,1,2,4,6,8", show_default=True, help="Largest delays in samples.")
@click.option("--hand", type=NumberList(), default="0,5,10", show_default=True, help="Least damping of a hand in N s/m.")
@click.option("--lever", type=float, default=1.0, show_default=True, help="Tip per angle, m/rad; 1: kg and N s/m at the tip.")
@click.option("--csv", "table", type=click.Path(path_type=Path, dir_okay=False), help="Write the table with the taps here.")
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="Write a page with the contours here.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
@json_option()
def command(
    period: tuple[float, ...], delay: tuple[float, ...], hand: tuple[float, ...], lever: float, table: Path | None,
    output: Path | None, force: bool, as_json: bool,
) -> None:  # fmt: skip
    """Show the stiffest wall that is safe for every passive hand: certified, beside its ceiling and what the field quotes.

    The device is the Omni of Chapter 6. A cell's coupler is safe at every delay from 0 up to its own.
    """
    from design.passivity.stiffness_map import stiffness_map
    from hil.files.outputs import check_output, check_page, write_output
    from hil.pages.analyses import stiffness_page
    from plants.omni import Omni
    from plants.parts.hand import Hand

    if not (lever > 0.0 and lever < float("inf")):
        raise HilError(f"--lever: {lever!r}, expected a finite number above 0")
    if max(delay) > 40:
        raise HilError(f"--delay: {max(delay):g}; a coupler for every delay up to it takes minutes, expected at most 40")
    if output is not None:
        check_page(output, force=force)
    if table is not None:
        check_output(table, fresh=not force, remedy="choose another name or add --force")
    omni = Omni(hand=Hand(), lever_m=lever)
    device = {"mass_kg": omni.tip_mass_kg, "damping_n_s_per_m": omni.tip_damping_n_s_per_m}
    with Working("stiffness map"):
        cells = stiffness_map(**device, periods_s=period, delays=[int(d) for d in delay], hands_n_s_per_m=hand)
    if table is not None:
        text = io.StringIO()
        writer = csv.DictWriter(text, list(asdict(cells[0])))
        writer.writeheader()
        for cell in cells:
            writer.writerow({**asdict(cell), "taps_m_per_n": " ".join(map(repr, cell.taps_m_per_n))})
        write_output(table, text.getvalue())
    document = {"device": device, "cells": [asdict(cell) for cell in cells]}
    show_page(stiffness_page(cells, **device), document, output, as_json)
