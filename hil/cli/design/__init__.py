"""``hil design``: gains for a plant over a network, and questions about them, which the files of this folder hold.

A question has the options that it alone takes, and an answer. A new one is a `Question` among the QUESTIONS of a file here.
"""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import click
from click.core import ParameterSource

from hil.cli.design_question import SHAPING, Question, names_of
from hil.cli.terminal import json_option
from hil.errors import HilError

QUESTIONS: list[Question] = [
    each for file in iter_modules(__path__) for each in import_module(f"{__name__}.{file.name}").QUESTIONS
]


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


@click.command(cls=GainsOrWall, params=[
    click.Argument(["subject"], metavar="PLANT|EXPERIMENT|wall"), *SHAPING, *(each for one in QUESTIONS for each in one.options)
])  # fmt: skip
@click.option("-o", "--output", "path", type=click.Path(path_type=Path, dir_okay=False), help="Write the design here.")
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
    question = min((each for each in QUESTIONS if each.asked(every)), key=lambda each: each.place)
    takes = question.takes
    means = takes | names_of(question.options) | ({"force"} if "path" in takes else set())
    context = click.get_current_context()
    for param in context.command.params:
        name = str(param.name)
        if name in every.keys() - means and context.get_parameter_source(name) is ParameterSource.COMMANDLINE:
            owner = next((each.name for each in QUESTIONS if name in names_of(each.options)), "")
            raise HilError(f"{param.opts[-1]}: " + (f"not with {question.name}" if question.name else f"belongs to {owner}"))
    if path is not None:
        (check_page if question.page else check_output)(path, force=force)  # now, and not after the work
    question.answer(**{name: every[name] for name in takes})
