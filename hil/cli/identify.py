"""``hil identify``: what logs tell of a plant, of its faults, and of a network: which law explains recorded packets, if any."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from msgspec.structs import asdict

from hil.cli.laws import files_of
from hil.cli.option_types import OUTPUT, PATH, Duration, Questions, Within
from hil.cli.terminal import Working, answer, json_option, print_facts, print_folded, print_written
from hil.errors import HilError, located

if TYPE_CHECKING:
    from design.identification.jump_rates import JumpRate
    from design.identification.output_error import AxisFit
    from hil.measure.identification_records import Axis, AxisRecord
    from transport.law_fit import LawFit


NONE = 1
LONGEST = 200
"""Characters of a value of a law that is printed."""


class Identifier(click.ParamType):  # type: ignore[type-arg]
    """A CAN identifier, decimal or 0x..."""

    name = "identifier"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        try:
            found = int(str(value), 0)
        except ValueError:
            found = -1
        if not 0 <= found < 1 << 29:
            self.fail(f"{value!r}, expected a CAN identifier such as 0x101", param, ctx)
        return found


@click.command()
@click.argument("files", metavar="FILE...", nargs=-1, required=True, type=PATH)
@click.option("--period", type=Duration(above=True), help="Length of a slot [the time between two packets].")
@click.option("--deadline", type=Within(0.0, 1.0, min_open=True, max_open=True), default=0.6, show_default=True,
              help="When a slot closes, as a share of it.")  # fmt: skip
@click.option("--halve", is_flag=True, help="Take half of a round trip for each direction.")
@click.option("--one-clock", is_flag=True, help="Both time stamps are of one clock: no offset, no drift.")
@click.option("--can-id", type=Identifier(), help="CAN logs: only frames of this identifier.")
@click.option("--answer-id", type=Identifier(), help="One CAN log: its frames of this identifier answer those of --can-id.")
@click.option("-o", "--output", type=OUTPUT, metavar="FILE.toml", help="Write the law here, for experiments.")
@click.option("--page", type=OUTPUT, metavar="PAGE.html", help="Write a page: measured and fitted side by side.")
@click.option("--force", is_flag=True, help="Replace files that are there; a page always is.")
@json_option()
def law(
    files: tuple[Path, ...], period: float | None, deadline: float, halve: bool, one_clock: bool, can_id: int | None,
    answer_id: int | None, output: Path | None, page: Path | None, force: bool,
) -> None:  # fmt: skip
    """Fit a network law to recorded packets: a log of hil probe or of a run (.mcap), a table (.csv), a capture of ping
    or of frames over zenoh (.pcap), two CAN logs of one bus (.log, .asc, .blf), the sender's first, or one with
    --can-id and --answer-id.

    Two tables are the two directions; -o law.toml then writes law.sc.toml and law.ca.toml. Exit status 1: none of
    the laws explains the packets, and no law is written.
    """
    from msgspec.structs import replace

    from hil.files import check_output, check_page, write_output
    from hil.log.recordings import fit_document, law_text, packet_records
    from hil.log.recordings.read import read_recording
    from transport.errors import FieldError
    from transport.law_fit import fit_law

    with Working(f"packets of {files[0]}"):
        recording = read_recording(files, can_id=can_id, answer_id=answer_id, one_clock=one_clock)
        records, notes = packet_records(recording, halve=halve)
    targets = {} if output is None else files_of(output, records)
    for path in targets.values():
        check_output(path, "a law", ".toml", force=force)
    check_page(page, force=force)
    fits = {}
    with Working("fit of network laws"):
        for way, record in records.items():
            slot = record.period_s if period is None else period
            if not slot > 0.0:
                raise HilError(f"{recording.source}: {way}: half of the packets or more have one time stamp; add --period")
            with located(f"{recording.source}: {way}", FieldError):
                timed = record if recording.clocks else replace(record, sent_s=record.sent_s * slot)  # one a slot
                fits[way] = fit_law(timed, slot, deadline * slot)
    said = {way: fit_document(fit, way, recording.source, notes) for way, fit in fits.items()}
    found = {way: fit for way, fit in fits.items() if fit.law_class != "none"}
    for way, path in targets.items():
        if way in found:
            write_output(path, law_text(found[way], said[way]), replace=force)
    if page is not None:
        from hil.pages.analyses import law_page

        write_output(page, law_page(fits, said, {way: _shares(fit) for way, fit in found.items()}))
    answer({way: {"law": fits[way].spec, "fit": said[way]} for way in fits}, _show_fits, fits, said, targets, page)
    if len(found) < len(fits):
        raise SystemExit(NONE)


def _shares(fit: LawFit) -> list[float]:
    from hil.experiment import parse_table
    from transport.law_tests.analysis import analyse_law

    shares = analyse_law(parse_table("hil.laws", fit.spec, "law"), fit.period_s, fit.deadline_s).age_shares
    return [float(share) for share in shares]


def _show_fits(fits: dict[str, LawFit], said: dict[str, dict[str, Any]], targets: dict[str, Path], page: Path | None) -> None:
    for way, fit in fits.items():
        _show(way, fit, said[way], targets.get(way))
    print_written(page)


def _show(way: str, fit: LawFit, said: dict[str, Any], path: Path | None) -> None:
    from hil.files.toml_text import toml_value
    from hil.log.recordings import class_text, fitted_value, independence_text, latencies_text

    print_folded(f"{way}: {class_text(fit)}; {said['packets']} packets, {said['lost']} did not come")
    for note in said["notes"]:
        _line(note)
    for line in independence_text(fit):
        _line(line)
    _line(latencies_text(fit))
    for name, (low, high) in list(said["intervals"].items())[:12]:
        _line(f"{name}: {fitted_value(fit, name):.4g}, 95 %: {low:.4g} to {high:.4g}")
    for age, (share, *pair) in enumerate(said.get("comes_at_age", [])[:8]):
        within = f"95 %: {pair[0]:.4g} to {pair[1]:.4g}" if pair else "no interval, as packets are not independent"
        _line(f"comes at age {age}, if not before: {share:.4g}, {within}")
    for each in fit.candidates[:6]:
        _line(f"tried {each.name} on {each.fitted_to}: {each.parameters} parameters, BIC {each.bic:.1f}")
    if fit.law_class == "none":
        what = "none of the laws explains these packets:" if fit.ages is not None else (
            "these packets depend on each other, and of their ages no chain can be counted: measure for longer, or"
        )
        _line(f'{what} replay them (kind = "trace", or latency = {{ file = ... }})')
        return
    click.echo("" if path is None else f"  written: {path}")
    if path is None:
        texts = {key: toml_value(value) for key, value in fit.spec.items()}
        cut = any(len(text) > LONGEST for text in texts.values())
        click.echo("".join(f"{key} = {text[:LONGEST]}{' ...' * (len(text) > LONGEST)}\n" for key, text in texts.items()))
        print_folded("-o law.toml writes it whole" if cut else "")


def _line(text: str) -> None:
    print_folded(f"  {text}", "    ")


@click.group(cls=Questions)
def command() -> None:
    """Estimate a plant, a network law or rates of faults from records."""


command.add_command(law)


@command.command()
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=PATH)
@click.option("--plant", "kind", type=click.Choice(["omni", "dc-motor"]), help="Axis [the plant of the log].")
@click.option("--input", "u_name", metavar="NAME", help="Signal that drives the axis [the plant's].")
@click.option("--measured", "y_name", metavar="NAME", help="Signal that is measured [the plant's].")
@json_option()
def plant(logs: tuple[Path, ...], kind: str | None, u_name: str | None, y_name: str | None) -> None:
    """Estimate inertia and damping (omni), or gain and pole (dc-motor), from one or more LOGs: .mcap, or .csv with times.

    All LOGs are fitted as one axis. Exit status 1 if the residuals are not noise, or dry friction is seen, which the
    model lacks: the intervals are then too narrow.
    """
    from design.errors import DesignError
    from design.identification import Record
    from design.identification.output_error import identify_axis
    from hil.measure.identification_records import AXES, read_axis_record

    records = [read_axis_record(path, kind, (u_name, y_name)) for path in logs]
    kinds = sorted({str(r.plant.get("kind")) for r in records if r.plant}) if kind is None else [kind]
    if len(kinds) > 1:
        raise HilError(f"logs of different plants: {', '.join(kinds)}; expected one, or --plant")
    made = []
    for record in records:
        with located(record.path, DesignError):
            made.append(Record(u=record.u, y=record.y, period_s=record.period_s))
    fit = identify_axis(made)
    said = _document(kinds[0], AXES[kinds[0]], records, fit)
    answer(said, _print, said, AXES[kinds[0]].parameters)
    if fit.residuals.verdict == "correlated" or said["friction"]["seen"]:
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
        "residuals": asdict(fit.residuals),
        "friction": _friction(axis, fit),
    }


def _friction(axis: Axis, fit: AxisFit) -> dict[str, Any]:
    """Return the dry friction beside the model; it is seen where its interval does not hold 0, and there is noise to judge by."""
    f, known = fit.friction, isfinite(fit.friction.error)
    seen = fit.residuals.verdict != "exact" and known and not f.covers(0.0)
    ends = {"value": f.value, "low": f.low, "high": f.high} if known else dict.fromkeys(("value", "low", "high"))
    return {**ends, "unit": axis.unit, "seen": seen}


WORDS = {
    "white": "white: nothing but damping is seen to brake the axis",
    "correlated": "correlated: the model or the noise is another, and the intervals are too narrow",
    "exact": "none: the model fits to rounding",
}


def _friction_in_words(friction: dict[str, Any], verdict: str) -> str:
    """Return what is known of the dry friction, and whether the intervals hold."""
    if friction["value"] is None:
        return "this motion cannot show it: the intervals hold if there is none"
    unit = friction["unit"]
    number = f"{friction['value']:.3g} {unit}, 99 %: {friction['low']:.3g} to {friction['high']:.3g} {unit}"
    if friction["seen"]:
        return f"{number}; the axis has none, and the intervals do not hold"
    if verdict == "white":
        return f"{number}; the intervals hold if there is none: as much would not be seen here, and shifts them"
    return number


def _print(said: dict[str, Any], units: Mapping[str, str]) -> None:
    facts = []
    for name, found in said["estimates"].items():
        logged = f"; the log ran with {said['logged'][name]:g}" if name in said["logged"] else ""
        within = f"95 %: {found['low']:.6g} to {found['high']:.6g}"
        facts.append((name, f"{found['value']:.6g} {units[name]}, {within}{logged}", ""))
    plain = said["plain_least_squares"]
    text = "gives none" if plain is None else ", ".join(f"{name} {value:.6g}" for name, value in plain.items())
    test = said["residuals"]
    tested = f" (Q = {test['statistic']:.3g} over {test['lags']} lags, p = {test['p_value']:.2g})"
    samples = f"{said['samples']} samples at {1e3 * said['period_s']:g} ms"
    print_facts((
        *facts,
        ("dry friction", _friction_in_words(said["friction"], said["residuals"]["verdict"]), ""),
        ("plain least squares", f"{text}, for comparison", ""),
        ("noise", f"{said['noise_sd']:.3g} rad (standard deviation), {samples}", ""),
        ("residuals", WORDS[test["verdict"]] + ("" if test["verdict"] == "exact" else tested), ""),
    ))  # fmt: skip
    click.echo("\n[plant]\nkind = " + json.dumps(said["plant"]))
    for name, found in said["estimates"].items():
        click.echo(f"{name} = {found['value']:.6g}")


@command.command()
@click.argument("logs", metavar="LOG...", nargs=-1, required=True, type=PATH)
@click.option("--edge", "edges", multiple=True, type=Duration(above=True),
              help="Sojourn at which the rate may change, such as 0.3s; repeatable.")  # fmt: skip
@click.option("--fault", default="fault_mode", show_default=True, metavar="NAME", help="State that is the true mode.")
@click.option("--detected", default="detected_mode", show_default=True, metavar="NAME", help="State that is the detected mode.")
@json_option()
def rates(logs: tuple[Path, ...], edges: tuple[float, ...], fault: str, detected: str) -> None:
    """Estimate the rates of a fault and of its detection (4.2) from one or more LOGs of a plant that logs both modes.

    Jumps are counted over the time in which they can occur, separately for every true mode; intervals are at 95 %.
    """
    from design.identification.jump_rates import jump_rates
    from hil.measure.identification_records import read_mode_record

    with Working("modes of the logs"):
        read = [read_mode_record(path, (fault, detected)) for path in logs]
    if len({restarts for _, restarts in read}) > 1:
        raise HilError("logs of different plants: failure_restarts_detection_clock is true in some and false in others")
    found = jump_rates([record for record, _ in read], edges, restarts=read[0][1])
    rates = [each._asdict() | {"before_s": each.before_s if isfinite(each.before_s) else None} for each in found]
    answer({"logs": [str(path) for path in logs], "rates": rates}, _show_rates, found)


def _show_rates(found: Sequence[JumpRate]) -> None:
    for each in found:
        what = "fault" if each.fault is None else f"detected, fault {each.fault}"
        until = f"{each.before_s:g}" if isfinite(each.before_s) else "..."
        click.echo(
            f"{what:>18}  {each.source} -> {each.to}  h {each.after_s:g} to {until} s: {each.rate:.4g} 1/s, "
            f"95 %: {each.low:.4g} to {each.high:.4g} ({each.jumps} jump{'s' * (each.jumps != 1)} in {each.exposure_s:.4g} s)"
        )
