"""``hil design PLANT|EXPERIMENT --local``: a design for the plant alone, and what the door says of it over the network."""

from __future__ import annotations

from typing import Any, get_args

from design.errors import DesignError, FieldError
from design.local import LocalMethod
from design.requests.tracking import LocalDesigned
from hil.certify.certifier import limited_to_model
from hil.certify.send_all_loop import judge_linear_law
from hil.cli.json_output import print_json
from hil.design_questions.design_problem import TrackingTarget, digest_of_law, model_at
from hil.errors import HilError

METHODS: tuple[str, ...] = get_args(LocalMethod)


def design_local(target: TrackingTarget, request: LocalDesigned) -> dict[str, Any]:
    """Return a local design as plain data: its matrices, its norms without a network, the verdict over the network.

    Raises:
        HilError: no such design.
    """
    from design.processes.delay_chain import DelayChain

    try:
        law = request.law(model_at(target))
    except FieldError as error:
        raise HilError(f"--{error.field.replace('_', '-')}: {error.message}") from error
    except DesignError as error:
        raise HilError(f"design: {error}") from error
    none = DelayChain(transition=((1.0,),))
    rho = request.input_weight
    alone = judge_linear_law(model_at(target), none, none, law, input_weight=rho).to_json()
    over_network = judge_linear_law(
        model_at(target), target.sc, target.ca, law, input_weight=rho, digest=digest_of_law(target, law)
    )  # fmt: skip
    verdict = limited_to_model(target.of, over_network)
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


def show_local(document: dict[str, Any], *, as_json: bool) -> None:
    """Print a local design."""
    if as_json:
        print_json(document)
        return
    from rich.console import Console

    console, alone, verdict = Console(), document["without_network"], document["verdict"]
    title = f"{document['plant']}, {document['local']} by python-control, period {document['period_s']:g} s"
    console.print(title, highlight=False, markup=False)
    for name, value, note in (
        ("H2 norm", f"{alone['h2']:.6g}", "of z = [C x; rho u], without a network"),
        ("H-infinity norm", f"{alone['hinf']:.6g}", "without a network"),
        ("second-moment radius", f"{alone['radius']:.6f}", "without a network"),
        ("over the network", verdict["state"], verdict["reason"]),
        ("in an experiment", "", f'[controller] kind = "local-designed", method = "{document["local"]}"'),
    ):
        console.print(f"{name:>22}  {value:<12} {note}", highlight=False, markup=False)
