"""``hil identify``: what logs tell of a plant, and of a network."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.identify_law import law
from hil.cli.json_output import json_option, print_json
from hil.errors import HilError

if TYPE_CHECKING:
    from design.identification.output_error import AxisFit
    from hil.measure.axis_record import Axis, AxisRecord


@click.group()
def command() -> None:
    """Estimate parameters from logs."""


command.add_command(law)


@command.command()
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--plant", "kind", type=click.Choice(["omni", "dc-motor"]), help="Axis [the plant of the log].")
@click.option("--input", "u_name", metavar="NAME", help="Signal that drives the axis [the plant's].")
@click.option("--measured", "y_name", metavar="NAME", help="Signal that is measured [the plant's].")
@json_option()
def plant(logs: tuple[Path, ...], kind: str | None, u_name: str | None, y_name: str | None, as_json: bool) -> None:
    """Estimate inertia and damping (omni), or gain and pole (dc-motor), from one or more LOGs: .mcap, or .csv with times.

    All LOGs are fitted as one axis. Exit status 1 if the residuals are not noise: the intervals are then too narrow.
    """
    from design.errors import DesignError
    from design.identification.axis import Record
    from design.identification.output_error import identify_axis
    from hil.measure.axis_record import AXES, read_axis_record

    records = [read_axis_record(path, kind, (u_name, y_name)) for path in logs]
    kinds = sorted({str(r.plant.get("kind")) for r in records if r.plant}) if kind is None else [kind]
    if len(kinds) > 1:
        raise HilError(f"logs of different plants: {', '.join(kinds)}; expected one, or --plant")
    made = []
    for record in records:
        try:
            made.append(Record(u=record.u, y=record.y, period_s=record.period_s))
        except DesignError as error:
            raise HilError(f"{record.path}: {error}") from error
    try:
        fit = identify_axis(made)
    except DesignError as error:
        raise HilError(f"identify: {error}") from error
    said = _document(kinds[0], AXES[kinds[0]], records, fit)
    if as_json:
        print_json(said)
    else:
        _print(said)
    if fit.residuals.verdict == "correlated":
        raise SystemExit(1)


def _document(kind: str, axis: Axis, records: list[AxisRecord], fit: AxisFit) -> dict[str, Any]:
    def pair(gain_and_pole: tuple[float, float] | None) -> dict[str, float] | None:
        if gain_and_pole is None:
            return None
        gain, pole = gain_and_pole
        return dict(zip(axis.parameters, (1.0 / gain, pole / gain) if axis.physical else (gain, pole)))

    found = (fit.inertia, fit.damping) if axis.physical else (fit.gain, fit.pole)
    return {
        "plant": kind,
        "logs": [r.path for r in records],
        "period_s": records[0].period_s,
        "samples": fit.samples,
        "estimates": {
            name: {"value": i.value, "error": i.error, "low": i.low, "high": i.high} for name, i in zip(axis.parameters, found)
        },
        "noise_sd": fit.noise_sd,
        "start": pair(fit.start),
        "plain_least_squares": pair(fit.plain),
        "logged": {name: records[0].plant[name] for name in axis.parameters if name in records[0].plant},
        "residuals": {
            "verdict": fit.residuals.verdict, "statistic": fit.residuals.statistic, "lags": fit.residuals.lags,
            "p_value": fit.residuals.p_value,
        },
    }  # fmt: skip


WORDS = {
    "white": "white: the intervals hold",
    "correlated": "correlated: the model or the noise is another, and the intervals are too narrow",
    "exact": "none: the model fits to rounding",
}


def _print(said: dict[str, Any]) -> None:
    for name, found in said["estimates"].items():
        logged = f"; the log ran with {said['logged'][name]:g}" if name in said["logged"] else ""
        click.echo(f"{name:>22}  {found['value']:.6g}, 95 %: {found['low']:.6g} to {found['high']:.6g}{logged}")
    plain = said["plain_least_squares"]
    text = "gives none" if plain is None else ", ".join(f"{name} {value:.6g}" for name, value in plain.items())
    test = said["residuals"]
    tested = f" (Q = {test['statistic']:.3g} over {test['lags']} lags, p = {test['p_value']:.2g})"
    for title, value in (
        ("plain least squares", f"{text}, for comparison"),
        ("noise", f"{said['noise_sd']:.3g} (standard deviation), {said['samples']} samples at {1e3 * said['period_s']:g} ms"),
        ("residuals", WORDS[test["verdict"]] + ("" if test["verdict"] == "exact" else tested)),
    ):
        click.echo(f"{title:>22}  {value}")
    click.echo("\n[plant]\nkind = " + json.dumps(said["plant"]))
    for name, found in said["estimates"].items():
        click.echo(f"{name} = {found['value']:.6g}")
