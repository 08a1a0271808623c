"""``hil list``, ``hil show``, ``hil schema``, ``hil solve``: experiments and plug-ins, those that come with the package first.

What is installed, and the keys of one of it; the file of an experiment, its schema, and the gains that stand beside it.
"""

from __future__ import annotations

import os
import sys
import textwrap
from typing import Any, Final

import click

from hil.cli.completion import EXPERIMENT
from hil.cli.terminal import Line, Working, answer, json_option, print_json, print_lines, terminal_columns, visible, wants_json
from hil.errors import HilError

DEEPEST: Final = 4
"""Levels of tables within tables that are shown."""
GROUPS = ("plants", "controllers", "laws", "links", "measures")


def _kinds(ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    """Return for the shell the plug-ins of the group that stands before."""
    from hil.plugins import registry

    group = ctx.params.get("group")
    return [name for name in registry.names(f"hil.{group}") if name.startswith(incomplete)] if group in GROUPS else []  # type: ignore[arg-type]


class Group(click.Choice[str]):
    """One of the groups; an experiment's name is answered with the command that prints it."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        from hil.experiment import shipped

        if value in shipped():
            self.fail(f"{value!r} is an experiment: hil show {value} prints its file.", param, ctx)
        return super().convert(value, param, ctx)


@click.command()
@click.argument("group", type=Group(GROUPS), required=False)
@click.argument("kind", required=False, shell_complete=_kinds)
@json_option()
def command(group: str | None, kind: str | None) -> None:
    """List the shipped experiments and the installed plug-ins.

    With GROUP only those, with what each of them is; with KIND also the keys of its table, their types, defaults and meaning:
    hil list controllers designed.
    """
    if group is None:
        _all()
    elif kind is None:
        _group(group)
    else:
        _kind(group, kind)


def _all() -> None:
    import tomllib

    from hil.experiment import FIRST, shipped
    from hil.plugins import registry

    tables = {name: tomllib.loads(path.read_text()) for name, path in shipped().items()}
    experiments = {name: table.get("description", "") for name, table in tables.items()}
    of = {name: str(table["plant"]["kind"]) for name, table in tables.items()}
    plugins = {
        group: {name: registry.provider(f"hil.{group}", name) for name in registry.names(f"hil.{group}")}  # type: ignore[arg-type]
        for group in GROUPS
    }
    answer({"experiments": experiments, "plants": of, "first": FIRST, "plugins": plugins}, _show_all, experiments, of, plugins)


def _show_all(experiments: dict[str, str], of: dict[str, str], plugins: dict[str, dict[str, str]]) -> None:
    from hil.experiment import FIRST

    print(f"to begin with: hil run {FIRST}; hil show {FIRST} prints its file\n")
    columns = _columns() if "COLUMNS" in os.environ or (sys.stdout and sys.stdout.isatty()) else sys.maxsize  # no pipe is narrow
    for plant in dict.fromkeys([of[FIRST], *of.values()]):
        print(f"experiments with the plant {visible(plant)}")
        names = [name for name in experiments if of[name] == plant]
        width = max(map(len, names))
        for name in sorted(names, key=lambda name: (name != FIRST, name)):
            print(f"  {name:<{width}}  {visible(one_line(experiments[name], columns - width - 4))}")
        print()
    for group, found in plugins.items():
        ours = [name for name, dist in found.items() if dist == "hilrig"]
        theirs = [f"{name} (from {dist})" for name, dist in found.items() if dist != "hilrig"]
        print(f"{group} (hil list {group} shows what they are)")
        print_lines([Line("", ", ".join(ours + theirs))])


def one_line(text: str, width: int) -> str:
    """Return the words of a text that have room in one line.

    >>> one_line("Networked DC motor, published gains", 24)
    'Networked DC motor, ...'
    """
    return textwrap.shorten(text, max(width, 20), placeholder=" ...")


def _group(group: str) -> None:
    from hil.plugins import registry
    from hil.plugins.fields import about

    found = {}
    for name in registry.names(f"hil.{group}"):  # type: ignore[arg-type]
        try:
            found[name] = " ".join(about(f"hil.{group}", name).split("\n\n")[0].split())  # type: ignore[arg-type]
        except HilError as error:  # a user's plug-in that cannot be imported
            found[name] = str(error)
    answer(found, _show_group, group, found)


def _show_group(group: str, found: dict[str, str]) -> None:
    print_lines([Line(f"  {name}", text) for name, text in found.items()])
    print(f"hil list {group} KIND shows its keys")


def _kind(group: str, kind: str) -> None:
    from hil.plugins import registry
    from hil.plugins.fields import about, fields_of

    cls = registry.load(f"hil.{group}", kind)  # type: ignore[arg-type]
    said, fields = about(f"hil.{group}", kind), fields_of(cls)  # type: ignore[arg-type]
    if wants_json():
        keys: dict[str, Any] = {f.name: {"type": f.type, "default": f.default or None, "meaning": f.meaning} for f in fields}
        print_json({"group": group, "kind": kind, "about": said, "keys": keys})
        return
    print(f"{kind}, from {visible(registry.provider(f'hil.{group}', kind))}\n")  # type: ignore[arg-type]
    _wrapped(visible_lines(said), "")
    if not fields:
        print("\nno keys" if isinstance(cls, type) else "")
        return
    print()
    _keys(cls, "")


def _keys(cls: object, within: str) -> None:
    """Print the keys of a table, those of a table inside it behind its own, as paths."""
    from hil.plugins.fields import fields_of, tables_of

    tables = tables_of(cls)
    for f in fields_of(cls):
        inside = next((name for name in (f.name, f"{f.name}.N") if name in tables), "")
        within_it = inside and "(" in f.default  # the default of a table: what it holds stands at its own keys
        default = "" if within_it or f.default == "None" else f" = {f.default}" if f.default else "  (required)"
        head = f"{within}{f.name}: {f.type}{default}"
        print(textwrap.fill(visible(head), _columns(), subsequent_indent="  ", break_on_hyphens=False))
        _wrapped([visible(f.meaning).replace("``", "")] if f.meaning else [], "    ")
        if inside and within.count(".") < DEEPEST:
            _keys(tables[inside], f"{within}{inside}.")


def visible_lines(text: str) -> list[str]:
    """Return the paragraphs of a text, escaped; what is indented keeps its lines.

    Args:
        text: of a docstring.
    """
    found: list[str] = []
    for paragraph in text.split("\n\n"):
        lines = paragraph.split("\n")
        indented = any(line.startswith(" ") for line in lines)
        found += [*map(visible, lines), ""] if indented else [visible(" ".join(lines)), ""]
    return found[:-1]


def _wrapped(lines: list[str], indent: str) -> None:
    for line in lines:
        if line.startswith(" ") or not line:
            print(f"{indent}{line}".rstrip())
        else:
            print(textwrap.fill(line, _columns(), initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False))


def _columns() -> int:
    return max(terminal_columns(), 60)


@click.command()
@click.argument("experiment", type=EXPERIMENT)
def show(experiment: str) -> None:
    """Print the file of a shipped EXPERIMENT: hil show dc-motor-hinf > mine.toml"""
    from hil.experiment import near_shipped, shipped

    found = shipped()
    if experiment not in found:
        hint = near_shipped(experiment) or ";"
        raise HilError(f"no shipped experiment {experiment!r:.80}{hint} `hil list` shows them")
    print(found[experiment].read_text(encoding="utf-8"), end="")


@click.command()
def schema() -> None:
    """Print the JSON Schema of experiment files (for editors: put its path in the file's `#:schema` line)."""
    from hil.experiment.schema import experiment_schema

    print_json(experiment_schema(warn=lambda said: print(f"hil: {visible(said)}", file=sys.stderr)))


@click.command()
@click.argument("experiments", metavar="EXPERIMENT...", nargs=-1, required=True)
def solve(experiments: tuple[str, ...]) -> None:
    """Solve the gains of every EXPERIMENT and store them in gains/NAME.json beside its file.

    Solved gains differ from machine to machine in their last digits. With the file beside it an experiment has the same
    bits on every machine. The file holds the digest of its problem: after a change of plant, network or request the
    gains are solved where they run, the summary says so, and this command stores the new ones.

    Exit status 2 where an experiment asks for no design, or no gains meet its request.
    """
    from hil.compose import solved_gains
    from hil.compose.stored_gains import gains_file, gains_text
    from hil.experiment import load_experiment
    from hil.files import made_folder, write_output

    for name in experiments:
        experiment = load_experiment(name)
        with Working(f"gains of {experiment.name}"):
            found = solved_gains(experiment)
        if found is None:
            raise HilError(f"{name}: its gains are given; there is nothing to solve")
        path = gains_file(experiment)
        made_folder(path.parent)
        write_output(path, gains_text(experiment, *found), replace=True)
        print(f"{path}: gains of {experiment.name} ({found[0].kind})")
