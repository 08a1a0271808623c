"""``--local``: a design for the plant alone, certified over the network."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from hil.cli.design_question import Question, option_faults
from hil.cli.option_types import Number
from hil.cli.terminal import Working, print_facts
from hil.cli.terminal import answer as print_answer

if TYPE_CHECKING:
    from design.requests.tracking import LocalDesigned
    from hil.design_questions import TrackingTarget


def answer(subject: str, period: float | None, input_weight: float | None, local: str, noise: float | None) -> None:
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
        motion_at(target), target.sc, target.ca, law, input_weight=rho, digest=digest_of_law(target, law)
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
        ("H2 norm", f"{alone['h2']:.6g}", "of z = [C x; rho u], without a network"),
        ("H-infinity norm", f"{alone['hinf']:.6g}", "without a network"),
        ("second-moment radius", f"{alone['radius']:.6f}", "without a network"),
        ("over the network", verdict["state"], verdict["reason"]),
        ("in an experiment", "", f'[controller] kind = "local-designed", method = "{document["local"]}"'),
    ))  # fmt: skip


QUESTION = Question(
    50, lambda options: options["local"],
    [click.Option(["--local"], type=click.Choice(["lqr", "lqg", "hinf"]),
                  help="Design for the plant without a network, by python-control, and judge it over the network."),
     click.Option(["--noise"], type=Number(), help="--local: noise of a sample per unit of the input disturbance [0.01].")],
    answer, "--local, which designs for the plant alone",
)  # fmt: skip
