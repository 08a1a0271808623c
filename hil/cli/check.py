"""``hil check``: hold a plug-in to what every one of its kind must keep, and say what it has earned."""

from __future__ import annotations

from typing import Any

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.terminal import json_option, print_json, visible
from hil.errors import HilError

GROUPS = ("plants", "controllers", "laws", "links", "measures")


@click.command()
@click.argument("group", type=click.Choice(GROUPS))
@click.argument("kind")
@click.option("--parameter", "sets", multiple=True, type=CHANGE, metavar="KEY=VALUE", help="A key of its table; repeatable.")
@click.option("--in", "experiment", default="dc-motor-hinf", show_default=True, type=EXPERIMENT, metavar="EXPERIMENT",
              help="The experiment whose model a controller, and whose run a measure is checked with.")  # fmt: skip
@json_option()
def command(group: str, kind: str, sets: tuple[str, ...], experiment: str, as_json: bool) -> None:
    """Check a plug-in and say what it has earned: hil check laws my_module:Mine --parameter p=0.3

    KIND is the name of an installed plug-in or module:Class of a file in this folder; of a link it is a URI. What is not kept is
    one message and exit status 2.
    """
    checks = {"plants": _plant, "controllers": _controller, "laws": _law, "links": _link, "measures": _measure}
    from hil.plugins.user_plugins import words
    from plants.errors import PlantError
    from transport import TransportError

    try:
        said = checks[group](kind, sets, experiment)
    except (HilError, TransportError, KeyboardInterrupt):
        raise
    except BaseException as fault:  # whatever a plug-in raises
        text = str(fault).partition("\n")[0] if isinstance(fault, AssertionError | PlantError) else words(fault)
        raise HilError(f"check_{group[:-1]}: {kind}: {text}") from fault
    if as_json:
        print_json({"group": group, "kind": kind, "earned": said})
        return

    print("\n".join(map(visible, said)))


def _made(group: Any, kind: str, sets: tuple[str, ...]) -> Any:
    from hil.experiment.load import parse_plugin

    return parse_plugin(group, kind, sets)


def _plant(kind: str, sets: tuple[str, ...], experiment: str) -> list[str]:
    from plants import check_plant

    return check_plant(_made("hil.plants", kind, sets))


def _law(kind: str, sets: tuple[str, ...], experiment: str) -> list[str]:
    from hil.plugins.checks import check_law

    return check_law(_made("hil.laws", kind, sets))


def _controller(kind: str, sets: tuple[str, ...], experiment: str) -> list[str]:
    from hil.compose.loop import compose
    from hil.experiment import load_experiment
    from hil.plugins.checks import check_controller
    from hil.plugins.protocols import Designer

    made = _made("hil.controllers", kind, sets)
    if isinstance(made, Designer):
        return [f"{type(made).__name__} is a Designer: an experiment that names it solves its gains, and judges their loop"]
    return check_controller(made, compose(load_experiment(experiment), certify=False).model)


def _measure(kind: str, sets: tuple[str, ...], experiment: str) -> list[str]:
    from hil.compose.loop import compose
    from hil.experiment import load_experiment
    from hil.measure.check import check_measure
    from hil.measure.measure import made_of
    from hil.measure.view import view_of
    from hil.pages.run.sections import check_section
    from hil.plugins import registry
    from hil.runtime.simulated import rehearsal

    if sets:
        raise HilError("--parameter: a measure has no keys")
    made = made_of(registry.load("hil.measures", kind))
    loop = compose(load_experiment(experiment), certify=False)
    view = view_of(rehearsal(loop), loop.experiment, loop.rig)
    return check_measure(made, view) + check_section(made, view)


def _link(kind: str, sets: tuple[str, ...], experiment: str) -> list[str]:
    from transport import check_link, open_link

    if sets:
        raise HilError("--parameter: a link's options stand in its URI")
    return check_link(lambda: (open_link(kind, "rig"), open_link(kind, "controller")))
