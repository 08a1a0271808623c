"""``hil completion``: let the shell complete commands, options, experiments and the keys of ``--set``."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_type_hints

import click

from hil.cli.option_types import Questions
from hil.errors import HilError

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

SHELLS = ("bash", "zsh", "fish")
PLACES = {
    "bash": ("XDG_DATA_HOME", ".local/share", "bash-completion/completions/hil"),
    "zsh": ("XDG_DATA_HOME", ".local/share", "zsh/site-functions/_hil"),
    "fish": ("XDG_CONFIG_HOME", ".config", "fish/completions/hil.fish"),
}
PLAIN = re.compile(r"[\w.-]+", re.ASCII)
"""What a shell may take into its line as it is: a key of a downloaded file could be `$(command)`."""

NEXT = {
    "bash": "a new bash completes hil, where the package bash-completion is installed; else add to ~/.bashrc: source {path}",
    "zsh": "add to ~/.zshrc, before compinit: fpath+=({folder})",
    "fish": "a new fish completes hil",
}


class ExperimentName(click.ParamType[str]):
    """An experiment: a shipped name or a TOML file; passed on as it is."""

    name = "experiment"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the shipped names that begin so, and leave files to the shell."""
        from click.shell_completion import CompletionItem

        from hil.experiment import shipped

        names = [CompletionItem(name) for name in shipped() if name.startswith(incomplete)]
        return names or [CompletionItem(incomplete, type="file")]


class FieldChange(click.ParamType[str]):
    """A change ``path=value`` of the experiment that is named before it; passed on as it is."""

    name = "path=value"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        """Return the paths that begin so, up to the next dot."""
        from click.shell_completion import CompletionItem, split_arg_string

        from hil.experiment import shipped
        from hil.experiment.check import MAX_BYTES
        from hil.experiment.tables import Experiment
        from hil.files import read_regular
        from hil.files.toml_text import parse_toml

        # Click gives up on arguments before an option that still lacks its value: the words themselves are read.
        words = split_arg_string(os.environ.get("COMP_WORDS", ""))[2:]
        source = next((word for word in words if word in shipped() or word.endswith(".toml")), None)
        if source is None or "=" in incomplete:
            return []
        try:
            text = read_regular(shipped().get(source, Path(source)), MAX_BYTES, "an experiment file").decode()
            paths = [*paths_of(Experiment, parse_toml(text))]  # nothing that the file names is run: no own module, no FMU
        except (HilError, ValueError, RecursionError):  # what is wrong is reported when the command runs
            return []
        return [CompletionItem(f"{path}=") for path in paths if path.startswith(incomplete) and PLAIN.fullmatch(path)]


EXPERIMENT = ExperimentName()
CHANGE = FieldChange()


def paths_of(cls: Any, said: dict[str, Any], at: str = "") -> Iterator[str]:
    """Give the paths of all keys that a table has, or may have: by its class, and by the plug-ins that its tables name.

    >>> [*paths_of(None, {"seed": 0, "plant": {"gain": 1.0, "kind": "dc-motor"}})]
    ['seed', 'plant.gain', 'plant.kind']
    """
    from hil.experiment.tables import HIDDEN
    from hil.plugins.fields import keys_of

    hints = {} if cls is None else get_type_hints(cls, include_extras=True)
    known = {} if cls is None else {each.key: hints[each.name] for each in keys_of(cls) if each.key not in HIDDEN}
    for key in known | said:
        table = said.get(key)
        of = _class_of(known.get(key), table)
        if of is None and not (isinstance(table, dict) and table):
            yield f"{at}{key}"
        else:
            yield from paths_of(of, table if isinstance(table, dict) else {}, f"{at}{key}.")


def _class_of(hint: Any, table: object) -> type | None:
    """Return what a table of a field fills: a class of ours, or the installed plug-in of its kind."""
    from hil.experiment.table import plug_in_of
    from hil.experiment.table_check import choices
    from hil.plugins import registry
    from hil.plugins.fields import is_table

    mark, kind = plug_in_of(hint), table.get("kind") if isinstance(table, dict) else None
    if mark is not None:
        return registry.load(mark.group, kind) if kind in registry.names(mark.group) else None
    return next(filter(is_table, choices(hint)), None)


def script(shell: str) -> str:
    """Return the script that makes a shell complete ``hil``.

    Args:
        shell: bash, zsh or fish.
    """
    from click.shell_completion import get_completion_class

    from hil.cli import cli

    kind = get_completion_class(shell)
    if kind is None:
        raise HilError(f"completion: no shell {shell!r}; expected one of {', '.join(SHELLS)}")
    made = kind(cli, {}, "hil", "_HIL_COMPLETE")
    text = str(made.source_template) % made.source_vars()
    if shell == "bash":  # after a key comes its value, not a space
        line = "COMPREPLY+=($value)"
        text = text.replace(line, f"{line}\n            [[ $value == *= ]] && compopt -o nospace")
    return text


def completion_fault(asked: str) -> str:
    """Return what is wrong with the question of a shell, nothing where it can be answered; click would show a traceback.

    Args:
        asked: value of ``_HIL_COMPLETE``, such as ``bash_complete``; its script sets COMP_WORDS and COMP_CWORD, too.
    """
    shell, _, what = asked.partition("_")
    if shell not in SHELLS or what not in ("source", "complete"):
        return f"_HIL_COMPLETE: {asked!r}; expected {SHELLS[0]}_complete or the like, which only a completion script sets"
    missing = [name for name in ("COMP_WORDS", "COMP_CWORD") if what == "complete" and name not in os.environ]
    if missing:
        return f"_HIL_COMPLETE: {asked!r} without {missing[0]}; only a completion script sets both: unset _HIL_COMPLETE"
    if what == "complete" and shell != "fish" and not os.environ["COMP_CWORD"].isdecimal():
        return f"COMP_CWORD: {os.environ['COMP_CWORD']!r} is not the number of a word"
    return ""


def completion_path(shell: str) -> Path:
    """Return where a shell looks for a user's completion of ``hil``.

    Args:
        shell: bash, zsh or fish.

    Raises:
        HilError: the user has no home.
    """
    variable, default, name = PLACES[shell]
    try:
        return Path(os.environ.get(variable) or Path.home() / default) / name
    except RuntimeError as error:
        raise HilError(f"{error} Set HOME, or {variable}") from error


def running_shell() -> str:
    """Return the user's shell as the environment names it, bash where it names another."""
    found = Path(os.environ.get("SHELL", "")).name
    return found if found in SHELLS else "bash"


@click.group(cls=Questions)
def command() -> None:
    """Let bash, zsh or fish complete commands, options, experiments and keys."""


@command.command()
@click.argument("shell", type=click.Choice(SHELLS), required=False)
def show(shell: str | None) -> None:
    """Print the script for SHELL, by default the running one."""
    print(script(shell or running_shell()))


@command.command()
@click.argument("shell", type=click.Choice(SHELLS), required=False)
def install(shell: str | None) -> None:
    """Write the script to the folder of SHELL, by default the running one; hil changes nothing outside your home."""
    from hil.files import made_folder, write_output

    chosen = shell or running_shell()
    path = completion_path(chosen)
    made_folder(path.parent)
    write_output(path, script(chosen))
    print(f"written: {path}\n{NEXT[chosen].format(path=path, folder=path.parent)}")
