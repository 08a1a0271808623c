"""Gains for a plant: over a network, between two norms (``--trade-off``), and without a network (``--local``)."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.design_question import Question, gain_unit, option_faults, shaped
from hil.cli.option_types import PATH, Number
from hil.cli.page_text import print_table, show_page
from hil.cli.terminal import Working, print_facts, visible
from hil.cli.terminal import answer as print_answer
from hil.errors import HilError, exit_status, located

if TYPE_CHECKING:
    from collections.abc import Iterable

    from design.processes.delay_chain import Array
    from design.requests.tracking import LocalDesigned
    from design.tracking.synthesis import Design
    from hil.design_questions import TrackingTarget
    from hil.design_questions.measured_network import Measured


def answer(
    subject: str, path: Path | None, force: bool, objective: str, hinf_bound: float | None, method: str,
    uncertainty: tuple[str, ...], robust: bool, network: Path | None, **shape: Any,
) -> None:  # fmt: skip
    """Solve gains, certify them, and write them for an experiment to name."""
    from design.requests.tracking import solve_tracking
    from design.tracking.design_file import design_text
    from hil.api.questions import DesignResult
    from hil.design_questions import problem_for
    from hil.design_questions.plant_uncertainty import interval, judge_uncertain, robust_design
    from hil.files import write_output

    target, options = shaped(subject, **shape)
    ways = None
    if network is not None:
        from hil.design_questions.measured_network import over_network

        with Working(f"network of {network}"):
            ways = measured_ways(network, target.period_s, target.deadline)
        target = over_network(target, *ways[:2])
    intervals = [interval(target.of, said) for said in uncertainty]
    if robust and (not intervals or objective != "h2" or method != "direct"):
        raise HilError("--robust: minimises the guaranteed H2 norm over --uncertainty; give one, with --objective h2")
    begun = time.perf_counter()
    try:
        with Working(f"{target.plant} {objective} {options['information']}") as watch:
            problem = problem_for(target, objective=objective, hinf_bound=hinf_bound, method=method, **options)
            design = solve_tracking(problem, progress=watch)
            if robust:
                design = robust_design(target, design, intervals, watch)
            document = DesignResult(target=target, design=design, wall_s=round(time.perf_counter() - begun, 3)).document()
            if ways is not None:
                document["network"] = network_document(target, design, *ways)
            if intervals:
                document["uncertainty"] = judge_uncertain(target, design, intervals).to_json()
                document["robust"] = robust
    except KeyboardInterrupt as interrupt:
        print("hil: design interrupted; nothing was written", file=sys.stderr)
        sys.exit(exit_status(interrupt))
    if path is not None:
        write_output(path, design_text(document), replace=force)
        document["file"] = str(path)
    print_answer(document, _show, design, document, gain_unit(target.of.inputs, target.of.outputs))


def measured_ways(path: Path, period_s: float, deadline: float) -> tuple[Measured, Measured, tuple[str, ...]]:
    """Return both directions of a measured link, the law of each fitted to its packets, and what was done about clocks.

    Fitting alone loads scipy.stats, half a second of CPU.

    Args:
        path: a log of `hil probe`, or of a run.
        period_s: length of a slot, s.
        deadline: until when what comes counts in it, a share of a slot.

    Raises:
        HilError: the log has one direction, or a direction that no law explains.
    """
    from hil.design_questions.measured_network import measured
    from hil.log.recordings import BACK, THERE, packet_records
    from hil.log.recordings.read import read_recording
    from transport.errors import FieldError
    from transport.law_fit import fit_law

    records, notes = packet_records(read_recording([path]))
    if THERE not in records or BACK not in records:
        said = f"holds {' and '.join(records)}; a design needs both directions, as `hil probe` measures them"
        raise HilError(f"--network {path}: {said}")
    found = {}
    for way, record in records.items():
        with located(f"--network {path}: {way}", HilError, FieldError):
            found[way] = measured(fit_law(record, period_s, deadline * period_s), holds_input=way == BACK)
    return found[THERE], found[BACK], notes


def network_document(
    target: TrackingTarget, design: Design, sc: Measured, ca: Measured, notes: tuple[str, ...]
) -> dict[str, Any]:
    """Return the laws of a measured network, and the verdict over all that the measurement leaves possible, as plain values."""
    from hil.design_questions.measured_network import region_verdict

    ways = {
        name: {"class": way.fit.law_class, "packets": len(way.fit.record.sent_s), "law": way.fit.spec, "max_age": way.at.max_age}
        for name, way in (("sc", sc), ("ca", ca))
    }
    return {**ways, "notes": list(notes), "region": region_verdict(target, design, sc, ca).to_json()}


def _show(design: Design, document: dict[str, Any], unit: str) -> None:
    from design.tracking import row_sojourns_of, state_gains_of
    from hil.pages import Table

    c, problem = design.certificate, design.problem
    sc, ca = problem.chains
    lasted = row_sojourns_of(ca)

    def heading(row: int) -> str:
        last = "+" if row % lasted == lasted - 1 else ""
        return f"d {row // lasted}, slot {row % lasted + 1}{last}" if lasted > 1 else f"row {row}"

    K, state_gains = state_gains_of(design.gains, problem.order)
    several = K[0, 0].size > 1  # numbers in a cell
    wide = max(len(f"{v:.5g}") for v in design.gains.ravel()) if several else 0
    stays = [(tau, at) for tau, count in enumerate(sc.sojourns) for at in range(1, count + 1)]

    def table(title: str, heads: Iterable[str], gains: Array) -> None:
        rows = [
            [
                f"{tau}, slot {at}{'+' if at == sc.sojourns[tau] else ''}" if len(stays) > len(sc.sojourns) else f"{tau}",
                *("  ".join(f"{v:>{wide}.5g}" for v in gain.ravel()) for gain in own),
            ]
            for (tau, at), own in zip(stays, gains, strict=True)
        ]
        print_table(Table(title=title, columns=["tau", *heads], rows=rows))

    sums, states = ["the sums of their errors"] * (problem.integral > 0), ["the controller's own state"] * (problem.order > 0)
    known = ", then ".join(["all outputs", *sums, *states])
    order = f"; in a row {known}{',' * bool(sums + states)} for the first input, then the next" if several else ""
    table(f"gains K[tau][row] in {unit}, row by {design.selection!r}{order}", map(heading, range(K.shape[1])), K)
    if problem.order:
        heads = (f"state {i + 1}" for i in range(problem.order))
        table(f"what makes the controller's own state of the next slot, of {known}", heads, state_gains)
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
        said = document["network"]
        lines += [(f"network, {way}", said[way]["class"], f"{said[way]['packets']} packets") for way in ("sc", "ca")]
        lines.append(("over all it leaves", said["region"]["state"], said["region"]["reason"]))
    if "file" in document:
        lines.append(("written", visible(document["file"]), ""))
    print_facts(lines)


def answer_trade_off(subject: str, path: Path | None, **shape: Any) -> None:
    """Solve the designs of a curve."""
    from hil.design_questions import compromises
    from hil.pages.designs import norm_trade_off_page

    target, options = shaped(subject, **shape)
    with Working(f"{target.plant} trade-off {options['information']}") as watch:
        found = compromises(target, watch, **options)
    document = {
        "plant": target.plant, "period_s": target.period_s, "information": options["information"],
        "designs": [each.to_json() for each in found],
    }  # fmt: skip
    show_page(norm_trade_off_page(target.plant, found), document, path)


def answer_local(subject: str, period: float | None, input_weight: float | None, local: str, noise: float | None) -> None:
    """Design for the plant alone; of the options that shape a networked design, none but the input's weight means anything."""
    from design.requests.tracking import LocalDesigned
    from hil.design_questions import tracking_target

    target = tracking_target(subject, period)
    given = {name: value for name, value in (("input_weight", input_weight), ("noise", noise)) if value is not None}
    with Working(f"{target.plant}, {local} without a network"):
        found = design_local(target, LocalDesigned(method=local, **given))  # type: ignore[arg-type]  # click knows the words
    print_answer(found, show_local, found)


def design_local(target: TrackingTarget, request: LocalDesigned) -> dict[str, Any]:
    """Return a local design as plain data: its matrices, its norms without a network, the verdict over the network.

    Raises:
        HilError: no such design.
    """
    from design.processes.delay_chain import DelayChain
    from hil.certify.send_all_loop import judge_linear_law
    from hil.design_questions import digest_of_law, model_at, motion_at, on_plant

    with option_faults():
        law = request.law(model_at(target))
    none = DelayChain(transition=((1.0,),))
    rho = request.input_weight
    alone = judge_linear_law(model_at(target), none, none, law, input_weight=rho).to_json()
    over_network = judge_linear_law(
        motion_at(target), *(target.reached or (target.sc, target.ca)), law, input_weight=rho, digest=digest_of_law(target, law)
    )  # fmt: skip
    verdict = on_plant(target, over_network)
    return {
        "plant": target.plant,
        "period_s": target.period_s,
        "local": request.method,
        "input_weight": rho,
        "noise": request.noise,
        "law": {"A": law.A.tolist(), "B": law.B.tolist(), "C": law.C.tolist(), "D": law.D.tolist()},
        "without_network": {"h2": alone["h2_norm"], "hinf": alone["hinf_norm"], "radius": alone["number"]},
        "verdict": verdict.to_json(),
    }


def show_local(document: dict[str, Any]) -> None:
    """Print a local design."""
    alone, verdict = document["without_network"], document["verdict"]
    click.echo(f"{document['plant']}, {document['local']} by python-control, period {document['period_s']:g} s")
    print_facts((
        ("H2 norm", f"{alone['h2']:.6g}", "of z = [C x; R u], without a network"),
        ("H-infinity norm", f"{alone['hinf']:.6g}", "without a network"),
        ("second-moment radius", f"{alone['radius']:.6f}", "without a network"),
        ("over the network", verdict["state"], verdict["reason"]),
        ("in an experiment", "", f'[controller] kind = "local-designed", method = "{document["local"]}"'),
    ))  # fmt: skip


QUESTIONS = (
    Question(
        90, lambda options: True,
        [click.Option(["--objective"], type=click.Choice(["h2", "hinf", "mixed"]), default="h2", show_default=True,
                      help="Norm to be small; mixed: the H2 norm, with the H-infinity norm below --hinf-bound."),
         click.Option(["--hinf-bound"], type=Number(), help="Bound of a mixed design [1.05 times the smallest H-infinity norm]."),
         click.Option(["--method"], type=click.Choice(["direct", "ccl"]), default="direct", show_default=True,
                      help="ccl: the thesis's iterated linear matrix inequalities, for comparison."),
         click.Option(["--uncertainty"], multiple=True, metavar="NAME=WIDTH",
                      help="Guarantee the design for a parameter of the plant within gain=10%, pole=0.3 (to either side) or "
                           "A.1.0=10%; repeatable."),
         click.Option(["--robust"], is_flag=True,
                      help="--uncertainty: gains of the smallest guaranteed H2 norm, instead of nominal ones."),
         click.Option(["--network"], type=PATH,
                      help="Design for the network of a log of `hil probe` or of a run, and certify over all that it leaves "
                           "possible.")],
        answer, page=False,
    ),
    Question(
        40, lambda options: options["trade_off"],
        [click.Option(["--trade-off"], is_flag=True,
                      help="H2 against H-infinity norm, mixed designs between the pure ones; -o: a page.")],
        answer_trade_off, "--trade-off, which solves designs of all three objectives",
    ),
    Question(
        50, lambda options: options["local"],
        [click.Option(["--local"], type=click.Choice(["lqr", "lqg", "hinf"]),
                      help="Design for the plant without a network, by python-control, and judge it over the network."),
         click.Option(["--noise"], type=Number(), help="--local: noise of a sample per unit of the input disturbance [0.01].")],
        answer_local, "--local, which designs for the plant alone",
    ),
)  # fmt: skip
