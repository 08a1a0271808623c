"""``hil design``: solve a tracking design, certify it, and write it for an experiment to name."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.option_types import Duration, Number
from hil.cli.page_text import print_table
from hil.cli.terminal import Working, answer, json_option, print_facts, visible
from hil.errors import HilError, exit_status

if TYPE_CHECKING:
    from design.tracking.synthesis import Design
    from hil.design_questions import TrackingTarget

NUMBER = Number()


class GainsOrWall(click.Command):
    """Hands what follows ``wall`` to `hil.cli.design_wall`."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        if args[:1] == ["wall"]:
            from hil.cli.design_wall import command as wall

            return wall.make_context(f"{info_name} wall", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)

    def invoke(self, ctx: click.Context) -> Any:
        return super().invoke(ctx) if ctx.command is self else ctx.command.invoke(ctx)


@click.command(cls=GainsOrWall)
@click.argument("subject", metavar="PLANT|EXPERIMENT|wall")
@click.option("--objective", type=click.Choice(["h2", "hinf", "mixed"]), default="h2", show_default=True,
              help="Norm to be small; mixed: the H2 norm, with the H-infinity norm below --hinf-bound.")  # fmt: skip
@click.option(
    "--information",
    type=click.Choice(["applied", "generated", "tau", "constant", "both", "previous", "total"]),
    default="applied",
    show_default=True,
    help="What a gain may depend on besides tau: d at application, d at generation (printed rule), nothing, ...",
)
@click.option("--gain-bound", type=NUMBER, help="Bound on every |entry| of every gain.")
@click.option("--hinf-bound", type=NUMBER, help="Bound of a mixed design [1.05 times the smallest H-infinity norm].")
@click.option("--input-weight", type=NUMBER, help="Weight R of the input, equal for every input [0.01].")
@click.option("--z", "z", type=click.Choice(["stacked", "sum"]), default="stacked", show_default=True,
              help="z = [Q x; R u], or Q x + R u as printed, whose terms may cancel.")  # fmt: skip
@click.option("--period", type=Duration(above=True), help="Sample period, such as 25ms [the thesis's, or the experiment's].")
@click.option("--samples", type=click.IntRange(1, 2), default=1, show_default=True, help="Samples per sensor packet.")
@click.option("--sojourns", type=click.IntRange(1), default=1, show_default=True,
              help="Slots that tau has lasted which a gain distinguishes; for semi-Markov delays.")  # fmt: skip
@click.option("--row-sojourns", type=click.IntRange(1), default=1, show_default=True,
              help="The same for d, with --information applied: a row for each d and each of so many slots.")  # fmt: skip
@click.option("--integral", type=NUMBER, default=0.0, help="Weight of the integrated error in z; > 0 adds integral action.")
@click.option("--starts", type=click.IntRange(0), default=0, help="Starts of the multistart [by objective].")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Of the starts of the multistart.")
@click.option("--method", type=click.Choice(["direct", "ccl"]), default="direct", show_default=True,
              help="ccl: the thesis's iterated linear matrix inequalities, for comparison.")  # fmt: skip
@click.option(
    "--uncertainty",
    multiple=True,
    metavar="NAME=WIDTH",
    help="Guarantee the design for a parameter of the plant within gain=10%, pole=0.3 (to either side) or A.1.0=10%; repeatable.",
)
@click.option("--robust", is_flag=True, help="--uncertainty: gains of the smallest guaranteed H2 norm, instead of nominal ones.")
@click.option(
    "--local",
    type=click.Choice(["lqr", "lqg", "hinf"]),
    help="Design for the plant without a network, by python-control, and judge it over the network.",
)
@click.option("--noise", type=NUMBER, help="--local: noise of a sample per unit of the input disturbance [0.01].")  # fmt: skip
@click.option(
    "--network",
    type=click.Path(path_type=Path),
    help="Design for the network of a log of `hil probe` or of a run, and certify over all that it leaves possible.",
)
@click.option("--orders", is_flag=True, help="Gains over historical data: try every order of the nodes' turns.")
@click.option("--spread", is_flag=True, help="Gains over historical data: the standard deviation of the cost over runs, too.")
@click.option("--trade-off", is_flag=True, help="H2 against H-infinity norm, mixed designs between the pure ones; -o: a page.")
@click.option("--trigger", is_flag=True, help="Threshold of the sensor node's trigger and gain: cost over packets; -o: a page.")
@click.option("--can-id", is_flag=True, help="Which CAN identifiers to take: cost over their place on the bus; -o: a page.")
@click.option("-o", "--output", "path", type=click.Path(path_type=Path, dir_okay=False), help="Write the design here.")
@click.option("--force", is_flag=True, help="Replace a file that is there; a page always is.")
@json_option()
def command(
    subject: str, objective: str, information: str, gain_bound: float | None, hinf_bound: float | None,
    input_weight: float | None, z: str, period: float | None, samples: int, sojourns: int, row_sojourns: int, integral: float,
    starts: int, seed: int, method: str, uncertainty: tuple[str, ...], local: str | None, noise: float | None, orders: bool,
    spread: bool, path: Path | None, force: bool, network: Path | None, can_id: bool,
    trade_off: bool, robust: bool, trigger: bool,
) -> None:  # fmt: skip
    """Design gains for a plant over the network (7.34), or for the plant and network of an experiment.

    ``hil design wall --help``: the coupler of a virtual wall. For an experiment with gains over historical data:
    the gains, what they cost, and what no controller can go below.

    Exit status 2 where no gains meet the request; the message has the number that decides it.
    """
    import numpy as np

    from design.requests.tracking import solve_tracking
    from design.tracking.design_file import design_text, to_document
    from hil.cli import design_answers as answers
    from hil.design_questions import problem_for, tracking_target, verdict_on
    from hil.design_questions.plant_uncertainty import interval, judge_uncertain, robust_design
    from hil.files import check_output, check_page, write_output
    from hil.log.write.provenance import package_versions

    if (can_id or trigger or trade_off) and path is not None:
        check_page(path, force=force)  # now, and not after the work
    if can_id:
        _refuse_others({"subject", "can_id", "path", "force", "as_json"}, "with --can-id, which runs the controller as it is")
        answers.show_can_id(subject, path)
        return
    if input_weight is not None and not (np.isfinite(input_weight) and input_weight >= 0):
        raise HilError(f"--input-weight: {input_weight:g}, expected a number >= 0")
    if trigger:
        mean = {"subject", "trigger", "gain_bound", "input_weight", "starts", "seed", "path", "force", "as_json"}
        _refuse_others(mean, "with --trigger, whose gains are H2 gains that use no ages: a silent node sends none")
        answers.show_trigger(subject, input_weight, {"gain_bound": gain_bound, "starts": starts, "seed": seed}, path)
        return
    experiment = answers.experiment_over_history(subject)
    if experiment is not None:
        _refuse_others({"subject", "orders", "spread", "as_json"}, "with gains over historical data, which [controller] asks for")
        answers.show_historical(experiment, orders, spread)
        return
    if orders or spread:
        raise HilError(f"--{'orders' if orders else 'spread'}: belongs to an experiment with gains over historical data")
    if trade_off:
        _refuse_others(set(answers.SHAPES), "with --trade-off, which solves designs of all three objectives")
    elif path is not None:
        check_output(path, force=force)  # now, and not after the work
    _check_row_sojourns(row_sojourns, information)
    target = tracking_target(subject, period, sojourns, row_sojourns)
    shape: dict[str, Any] = {
        "information": information, "gain_bound": gain_bound, "output": z, "samples": samples, "integral": integral,
        "starts": starts, "seed": seed, "R": None if input_weight is None else np.full(target.B.shape[1], input_weight),
    }  # fmt: skip
    if trade_off:
        answers.show_trade_off(target, shape, path)
        return
    ways = None
    if network is not None:
        with Working(f"network of {network}"):
            sc, ca, *_ = ways = answers.measured_ways(network, target.period_s)
        target = target._replace(sc=sc.chain(), ca=ca.chain())
    if local is not None:
        _local(target, local, input_weight, noise)
        return
    if noise is not None:
        raise HilError("--noise: belongs to --local")
    intervals = [interval(target.of, said) for said in uncertainty]
    if robust and (not intervals or objective != "h2" or method != "direct"):
        raise HilError("--robust: minimises the guaranteed H2 norm over --uncertainty; give one, with --objective h2")
    begun = time.perf_counter()
    try:
        with Working(f"{target.plant} {objective} {information}") as watch:
            problem = problem_for(target, objective=objective, hinf_bound=hinf_bound, method=method, **shape)
            design = solve_tracking(problem, progress=watch)
            if robust:
                design = robust_design(target, design, intervals, watch)
            wall_s = round(time.perf_counter() - begun, 3)
            document = to_document(
                design, plant=target.plant, period_s=target.period_s, wall_s=wall_s, versions=package_versions()
            )
            document["verdict"] = verdict_on(target, design).to_json()
            if ways is not None:
                document["network"] = answers.network_document(target, design, *ways)
            if intervals:
                document["uncertainty"] = judge_uncertain(target, design, intervals).to_json()
                document["robust"] = robust
    except KeyboardInterrupt as interrupt:
        print("hil: design interrupted; nothing was written", file=sys.stderr)
        sys.exit(exit_status(interrupt))
    if path is not None:
        write_output(path, design_text(document), replace=force)
        document["file"] = str(path)
    answer(document, _show, design, document, answers.gain_unit(target.of.inputs, target.of.outputs))


def _local(target: TrackingTarget, method: str, input_weight: float | None, noise: float | None) -> None:
    """Design for the plant alone; of the options that shape a networked design, none but the input's weight means anything."""
    from design.requests.tracking import LocalDesigned
    from hil.cli.design_answers import design_local, show_local

    common = {"subject", "period", "input_weight", "local", "noise", "as_json"}
    _refuse_others(common, "with --local, which designs for the plant alone")
    request = LocalDesigned(
        method=method, input_weight=0.01 if input_weight is None else input_weight, noise=0.01 if noise is None else noise  # type: ignore[arg-type]
    )  # fmt: skip
    with Working(f"{target.plant}, {method} without a network"):
        found = design_local(target, request)
    answer(found, show_local, found)


def _check_row_sojourns(row_sojourns: int, information: str) -> None:
    from design.controllers import check_row_sojourns
    from design.errors import FieldError

    try:
        check_row_sojourns(row_sojourns, information, "--information")
    except FieldError as error:
        raise HilError(f"--row-sojourns: {error.message}") from None


def _refuse_others(common: set[str], where: str) -> None:
    """Refuse an option that was given and means nothing here."""
    from click.core import ParameterSource

    context = click.get_current_context()
    given = [p for p in context.command.params if p.name and context.get_parameter_source(p.name) is ParameterSource.COMMANDLINE]
    others = [p.opts[-1] for p in given if p.name not in common]
    if others:
        raise HilError(f"{others[0]}: not {where}")


def _show(design: Design, document: dict[str, Any], unit: str) -> None:
    from design.tracking import row_sojourns_of
    from hil.pages import Table

    c, problem = design.certificate, design.problem
    sc, ca = problem.chains
    lasted = row_sojourns_of(ca)

    def heading(row: int) -> str:
        last = "+" if row % lasted == lasted - 1 else ""
        return f"d {row // lasted}, slot {row % lasted + 1}{last}" if lasted > 1 else f"row {row}"

    several = design.gains[0, 0].size > 1  # numbers in a cell
    wide = max(len(f"{v:.5g}") for v in design.gains.ravel()) if several else 0
    stays = [(tau, at) for tau, count in enumerate(sc.sojourns) for at in range(1, count + 1)]
    rows = [
        [
            f"{tau}, slot {at}{'+' if at == sc.sojourns[tau] else ''}" if len(stays) > len(sc.sojourns) else f"{tau}",
            *("  ".join(f"{v:>{wide}.5g}" for v in gain.ravel()) for gain in gains),
        ]
        for (tau, at), gains in zip(stays, design.gains, strict=True)
    ]
    heads = ["tau", *map(heading, range(design.gains.shape[1]))]
    order = "; in a row all outputs for the first input, then the next" if several else ""
    print_table(Table(title=f"gains K[tau][row] in {unit}, row by {design.selection!r}{order}", columns=heads, rows=rows))
    bounds = document["lower_bounds"]
    lines = [
        ("H2 norm", f"{c.h2_norm:.6g}", f"any causal controller: >= {bounds['h2_delayed_information']:.4g}" if bounds else ""),
        ("mode at its impulse", c.initial, ""),
        (
            "H-infinity norm",
            f"{c.hinf_norm:.6g}",
            f"any causal controller: >= {bounds['hinf_delayed_information']:.4g}" if bounds else "",
        ),
        ("verdict", document["verdict"]["state"], document["verdict"]["reason"]),
        ("second-moment radius", f"{c.mean_square_radius:.6f}", "linear model: " + ("stable" if c.stable else "NOT STABLE")),
        ("margin of (7.17)", f"{c.lyapunov_margin:.3g}", f"rounding {c.rounding:.1g}"),
        ("margin of (7.28)", "-" if c.hinf_margin is None else f"{c.hinf_margin:.3g}", "at gamma (1 + 1e-6)"),
        ("solved in", f"{document['wall_s']} s", f"{design.evaluations} norms, {len(design.starts)} starts, seed {problem.seed}"),
    ]
    if "uncertainty" in document:
        found = document["uncertainty"]
        for one in found["parameters"]:
            lines.append((one["name"], f"{one['nominal']:.5g}", f"from {one['low']:.5g} to {one['high']:.5g}, drifting or not"))
        lines.append(("uncertainty", found["state"], found["reason"]))
        if found["h2_norm"] is not None:
            lines.append(("guaranteed H2 norm", f"{found['h2_norm']:.6g}", ""))
            lines.append(("guaranteed H-infinity", f"{found['hinf_norm']:.6g}", ""))
    if "network" in document:
        from hil.cli.design_answers import network_lines

        lines += network_lines(document["network"])
    if "file" in document:
        lines.append(("written", visible(document["file"]), ""))
    print_facts(lines)
