"""``hil stiffness-map``: how stiff a wall may be over rate, delay and hand damping, certified."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict
from pathlib import Path
from textwrap import fill

import click

from hil.cli.option_types import NumberList
from hil.cli.terminal import json_option, print_json, terminal_columns
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
    from hil.cli.terminal import Working
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
    device = Omni(hand=Hand(), lever_m=lever)
    with Working("stiffness map"):
        cells = stiffness_map(
            mass_kg=device.tip_mass_kg, damping_n_s_per_m=device.tip_damping_n_s_per_m, periods_s=period,
            delays=[int(d) for d in delay], hands_n_s_per_m=hand,
        )  # fmt: skip
    if table is not None:
        text = io.StringIO()
        writer = csv.DictWriter(text, list(asdict(cells[0])))
        writer.writeheader()
        for cell in cells:
            writer.writerow({**asdict(cell), "taps_m_per_n": " ".join(map(repr, cell.taps_m_per_n))})
        write_output(table, text.getvalue())
    if output is not None:
        write_output(output, stiffness_page(cells, mass_kg=device.tip_mass_kg, damping_n_s_per_m=device.tip_damping_n_s_per_m))
    if as_json:
        device_said = {"mass_kg": device.tip_mass_kg, "damping_n_s_per_m": device.tip_damping_n_s_per_m}
        print_json({"device": device_said, "cells": [asdict(cell) for cell in cells]})
        return
    from rich.console import Console
    from rich.table import Table

    shown = Table(title="stiffness in N/m that is safe for every passive hand, by delay in samples and hand in N s/m")
    for name in ("T", "delay", "hand", "certified", "ceiling", "Colgate", "Gil-Hulin", "exact, bare"):
        shown.add_column(name, justify="right")
    for c in cells:
        colgate = "-" if c.colgate_n_per_m is None else f"{c.colgate_n_per_m:.1f}"
        shown.add_row(
            f"{1e3 * c.period_s:g} ms", f"0..{c.delay}", f"{c.hand_damping_n_s_per_m:g}", f"{c.certified_n_per_m:.1f}",
            f"{c.ceiling_n_per_m:.1f}", colgate, f"{c.gil_hulin_n_per_m:.1f}", f"{c.exact_n_per_m:.1f}",
        )  # fmt: skip
    Console().print(shown)
    said = "Colgate, Gil-Hulin, exact: a wall without a coupler and without damping of its own; the last for no hand at all."
    click.echo(fill(said, terminal_columns(), break_on_hyphens=False))
