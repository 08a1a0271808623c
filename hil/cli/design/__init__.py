"""``hil design``: gains for a plant over a network, and questions about them, which the files of this folder hold.

A question has the options that it alone takes, and an answer. A new one is a `Question` among the QUESTIONS of a file here.
``hil design wall`` is a certified coupler for a device, ``hil stiffness-map`` how stiff a wall may be for many.
"""

from __future__ import annotations

import csv
import io
import json
from importlib import import_module
from importlib.resources import files
from pathlib import Path
from pkgutil import iter_modules
from string import Template
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from hil.cli.design_question import SHAPING, Question, names_of
from hil.cli.option_types import LARGEST, OUTPUT, Duration, NumberList, Ratio, Within
from hil.cli.page_text import show_page
from hil.cli.terminal import Working, answer, json_option, print_facts, print_written
from hil.errors import HilError, located

if TYPE_CHECKING:
    from design.passivity.synthesis import CouplerDesign

QUESTIONS: list[Question] = [
    each for file in iter_modules(__path__) for each in import_module(f"{__name__}.{file.name}").QUESTIONS
]


class GainsOrWall(click.Command):
    """Hands what follows the word ``wall`` to the command of this name."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        if args[:1] == ["wall"]:
            return wall.make_context(f"{info_name} wall", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        return super().invoke(ctx) if ctx.command is self else ctx.command.invoke(ctx)


@click.command(cls=GainsOrWall, params=[
    click.Argument(["subject"], metavar="PLANT|EXPERIMENT|wall"), *SHAPING, *(each for one in QUESTIONS for each in one.options)
])  # fmt: skip
@click.option("-o", "--output", "path", type=OUTPUT, metavar="FILE.json", help="Write the design here.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
@json_option()
def command(subject: str, path: Path | None, force: bool, **options: Any) -> None:
    """Design gains for a plant over the network (7.34), or for the plant and network of an experiment.

    ``hil design wall --help``: the coupler of a virtual wall. For an experiment with gains over historical data:
    the gains, what they cost, and what no controller can go below.

    Exit status 2 where no gains meet the request; the message has the number that decides it.
    """
    from hil.files import check_output, check_page

    every = {"subject": subject, "path": path, "force": force, **options}
    question = next(each for each in sorted(QUESTIONS, key=lambda each: each.place) if each.asked(every))
    takes = question.takes
    means = takes | names_of(question.options) | ({"force"} if "path" in takes else set())
    context = click.get_current_context()
    for param in context.command.params:
        name = str(param.name)
        if name in every.keys() - means and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            if name == "path":
                raise HilError(f"-o: not with {question.name}; --json > FILE.json keeps the answer")
            owner = next((each.name for each in QUESTIONS if name in names_of(each.options)), "")
            raise HilError(f"{param.opts[-1]}: " + (f"not with {question.name}" if question.name else f"belongs to {owner}"))
    if question.page:  # now, and not after the work
        check_page(path, force=force)
    else:
        check_output(path, "a design", ".json", force=force)
    question.answer(**{name: every[name] for name in takes})


HELD = "(z - 1)/(T z) C(z) - (1 - z^-(nd + 1))/(2 b) is positive real for every delay nd, in integer arithmetic (Sturm)"
VARYING = "(z - 1)/(T z) C(z) - sum (1 - z^-(nd + 1))/(2 b) is positive real, over all delays nd, in integer arithmetic (Sturm)"


@click.command("wall")
@click.option("--period", type=Duration(above=True), default="1ms", show_default=True, help="Sample period T.")
@click.option("--delay", type=NumberList(whole=True), default="0..6", show_default=True, help="Delays in samples that are safe.")
@click.option("--hand", type=Within(min=0.0), default=0.0, show_default=True, help="Smallest damping of a hand in N s/m.")
@click.option("--damping", type=Within(min=0.0), help="Damping b of the device in N s/m [the Omni's].")
@click.option("--stiffness", type=Within(min=0.0, min_open=True), help="Static stiffness in N/m to be reached.")
@click.option("--taps", type=click.IntRange(1), help="Number of taps [as the delays call for].")
@click.option("--varying", is_flag=True, help="Also safe while the delay of one direction varies from sample to sample.")
@click.option("--weight", type=Ratio(), help="W(z) whose largest |W C| is minimised, such as 1,-0.97/1,-0.9, in powers of 1/z.")
@click.option("-o", "--output", "path", type=OUTPUT, metavar="FILE.json", help="Write the design here.")
@click.option("--c", "header", type=OUTPUT, metavar="FILE.h", help="Write a C99 header here.")
@click.option("--force", is_flag=True, help="Replace files that are there.")
@json_option()
def wall(
    period: float, delay: tuple[float, ...], hand: float, damping: float | None, stiffness: float | None, taps: int | None,
    varying: bool, weight: tuple[tuple[float, ...], tuple[float, ...]] | None, path: Path | None, header: Path | None,
    force: bool,
) -> None:  # fmt: skip
    """Design the stiffest coupler that is safe for every passive hand at every delay of a set.

    A weight W makes it stiff where |W| is large: it minimises the largest |W(z) C(z)| on the unit circle, C = 1/Q - 1/G the
    error of the rendered compliance. A weight that is largest at 0 Hz changes nothing.

    Exit status 2 where the stiffness cannot be reached; the message has the number that decides it.
    """
    from design.errors import FieldError
    from design.passivity.certificate import lags
    from design.passivity.condition import damping_needed
    from design.passivity.synthesis import Weight, ceiling_n_per_m, stiffest_coupler
    from hil.files import check_output, write_output
    from plants.omni import Omni

    check_output(path, "a design", ".json", force=force)
    check_output(header, "a C header", ".h", force=force)
    beta = (Omni().damping if damping is None else damping) + hand
    delays = [int(d) for d in delay]
    if varying:  # from sample to sample it rises by one at most
        delays = [*lags(delays, [0])]
    with located("--weight", FieldError), Working("coupler of a wall"):
        asked = None if weight is None else Weight(*weight)
        found = stiffest_coupler(
            delays, period_s=period, damping_n_s_per_m=beta, taps=taps, stiffness_n_per_m=stiffness, varying=varying,
            weight=asked,
        )  # fmt: skip
        plain = found if asked is None else stiffest_coupler(
            delays, period_s=period, damping_n_s_per_m=beta, taps=taps, varying=varying
        )  # fmt: skip
    document = {
        "kind": "coupler",
        "period_s": period,
        "delays": list(found.delays),
        "damping_n_s_per_m": beta,
        "taps_m_per_n": list(found.coupler.taps_m_per_n),
        "static_compliance_m_per_n": found.coupler.static_compliance_m_per_n,
        "stiffness_n_per_m": found.stiffness_n_per_m,
        "ceiling_n_per_m": ceiling_n_per_m(period, beta, max(delays)),
        "bound_m_per_n": found.bound_m_per_n,
        "damping_needed_n_s_per_m": damping_needed(found.coupler, period, delays, varying=varying).damping_n_s_per_m,
        "proof": VARYING if varying else HELD,
    }
    weighed: tuple[tuple[str, str, str], ...] = ()
    if asked is not None:
        largest, before = (asked.peak(each.coupler) for each in (found, plain))
        document["weight"] = {
            "numerator": list(asked.numerator), "denominator": list(asked.denominator), "largest_m_per_n": largest,
            "of_the_stiffest_m_per_n": before,
        }  # fmt: skip
        weighed = (("weight", f"largest |W C| {largest:.6g} m/N, {before:.6g} of the stiffest", ""),)
    text = json.dumps(document, indent=2) + "\n"
    if path is not None:
        write_output(path, text)
    if header is not None:
        write_output(header, _header(found))
    safe = f"delays {', '.join(map(str, found.delays))} samples{', varying' if varying else ''}"
    compliance = found.coupler.static_compliance_m_per_n
    facts = (
        ("stiffness", f"{found.stiffness_n_per_m:.6g} N/m, {document['ceiling_n_per_m']:.6g} N/m is the ceiling", ""),
        ("static compliance", f"{compliance:.6g} m/N, at least {found.bound_m_per_n:.6g} m/N for these delays", ""),
        ("certified", f"{safe}, any passive hand, {beta:g} N s/m of damping", ""),
        *weighed,
        ("taps", f"{len(found.coupler.taps_m_per_n)}, m/N: {_listed(found.coupler.taps_m_per_n)}", ""),
    )  # fmt: skip

    def show() -> None:
        print_facts(facts)
        print_written(path, header)

    answer(document, show)


def _listed(taps: tuple[float, ...]) -> str:
    """Taps to five digits; what is rounding beside the largest is 0.

    >>> _listed((0.01, 4.36e-17, -0.0))
    '0.01 0 0'
    """
    least = 1e-12 * max(map(abs, taps))
    return " ".join(f"{tap:.5g}" if abs(tap) > least else "0" for tap in taps)


def _header(design: CouplerDesign) -> str:
    """Return a coupler as a C99 header: its taps, and the wall of one sample for the callback of a haptic device."""
    text = Template(files("hil.design_questions").joinpath("coupler.h").read_text(encoding="utf-8"))
    return text.substitute(
        delays=", ".join(map(str, design.delays)), period=repr(design.period_s), damping=repr(design.damping_n_s_per_m),
        stiffness=f"{design.stiffness_n_per_m:.6g}", count=len(design.coupler.taps_m_per_n),
        taps=",\n".join(f"    {tap!r}" for tap in design.coupler.taps_m_per_n),
    )  # fmt: skip


@click.command()
@click.option("--period", type=NumberList(above=True, times=True), default="1ms,50ms", show_default=True, help="Sample periods.")
@click.option("--delay", type=NumberList(whole=True), default="0,1,2,4,6,8", show_default=True, help="Largest delays in samples.")
@click.option("--hand", type=NumberList(), default="0,5,10", show_default=True, help="Smallest damping of a hand in N s/m.")
@click.option("--lever", type=float, default=1.0, show_default=True, help="Tip per angle, m/rad; 1: kg and N s/m at the tip.")
@click.option("--csv", "table", type=OUTPUT, metavar="FILE.csv", help="Write the table with the taps here.")
@click.option("-o", "--output", type=OUTPUT, metavar="PAGE.html", help="Write a page with the contours here.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
@json_option()
def stiffness_map(
    period: tuple[float, ...], delay: tuple[float, ...], hand: tuple[float, ...], lever: float, table: Path | None,
    output: Path | None, force: bool,
) -> None:  # fmt: skip
    """Show the stiffest wall that is safe for every passive hand: certified, beside its bound and values of the literature.

    The device is the Omni of Chapter 6. A cell's coupler is safe at every delay from 0 up to its own.
    """
    from msgspec.structs import asdict

    from design.passivity.stiffness_map import stiffness_map
    from hil.files import check_output, check_page, write_output
    from hil.pages.analyses import stiffness_page
    from plants.omni import Omni
    from plants.parts.hand import Hand

    if not 1.0 / LARGEST <= lever <= LARGEST:
        raise HilError(f"--lever: {lever!r}, expected {1.0 / LARGEST:g} to {LARGEST:g} m/rad")
    if max(delay) > 40:
        raise HilError(f"--delay: {max(delay):g}; a coupler for every delay up to it takes minutes, expected at most 40")
    check_page(output, force=force)
    check_output(table, "a table", ".csv", force=force)
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
    show_page(stiffness_page(cells, **device), document, output, table)
