"""``hil new``, ``hil check``: a part of the user's own that runs as it is written, and what a plug-in has earned."""

from __future__ import annotations

import keyword
import re
import shlex
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from hil.cli.completion import CHANGE, EXPERIMENT
from hil.cli.list import GROUPS
from hil.cli.option_types import NamedPath
from hil.cli.terminal import Working, answer, json_option, print_each_folded, visible
from hil.errors import HilError

if TYPE_CHECKING:
    from hil.cli.new_external import ExternalController

PERIOD_S = 0.01
"""Period at which a plant is checked, s."""
PARTS = ("plant", "controller", "law", "measure", "experiment")


@click.command()
@click.argument("part", type=click.Choice(PARTS))
@click.argument("name")
@click.option("-o", "--output", "folder", type=NamedPath(file_okay=False, path_type=Path), default=Path("."),
              help="Folder to write to, made if needed; the working folder by default.")  # fmt: skip
@click.option("--language", type=click.Choice(["python", "c"]),
              help="controller: a program of its own in this language, for `hil rig EXPERIMENT`.")  # fmt: skip
@click.option("--for", "rig", type=EXPERIMENT, metavar="EXPERIMENT",
              help="With --language: the experiment whose rig and gains the program has. By default dc-motor-hinf.")  # fmt: skip
@click.option("--link", "kind", type=click.Choice(["can", "zenoh"]), help="With --language: the link. Default: can.")
@click.option("--keyed", is_flag=True, help="With --language: every packet has a message authentication code.")
@click.option("--force", is_flag=True, help="Replace files that are there.")
def new(
    part: str, name: str, folder: Path, language: str | None, rig: str | None, kind: str | None, keyed: bool, force: bool
) -> None:
    """Write a plant, controller, law, measure or experiment of your own: hil new plant cart

    Makes cart.py with the class Cart, the experiment cart.toml that runs it, and the pytest file test_cart.py. All run as they
    are; change them from there.

    With --language a controller is a program that needs nothing of hilrig:
    hil new controller drive --language c --for dc-motor-h2
    """
    from hil.files import made_folder, written_whole

    if not re.fullmatch(r"[a-z][a-z0-9_-]{0,63}", name, re.ASCII):
        raise HilError(f"NAME: {name!r:.80}: expected lower-case letters, digits, _ or -: hil new {part} my_{part}")
    module = name.replace("-", "_")
    if keyword.iskeyword(module) or _is_taken(module):
        raise HilError(f"NAME: {name!r}: Python has a module or a word of this name; take another: hil new {part} my_{module}")
    if language is None and (keyed or kind is not None):
        raise HilError("--link and --keyed: only for a program (--language python or c); a plug-in runs on any link")
    if language is None and rig is not None:
        raise HilError("--for: only for a program (--language python or c); a plug-in runs in the experiment that names it")
    if language is not None and part != "controller":
        raise HilError(f"--language: for a controller, not for a {part}: hil new controller {module} --language {language}")
    of, note = None, ""
    if language is None:
        files = files_of(part, module)
    else:
        of, files, note = _program(module, language, rig or "dc-motor-hinf", kind or "can", keyed)
    texts = {folder / file: text for file, text in files.items()}
    shared = [path for path, text in texts.items() if module not in path.name and _holds(path, text)]  # of another program
    texts = {path: text for path, text in texts.items() if path not in shared}
    there = [path for path in texts if path.exists() or path.is_symlink()]
    if there and not force:
        own = module in there[0].name
        remedy = "choose another name" if own else "it is of another program, with other packets; choose another folder with -o"
        raise HilError(f"{there[0]}: exists already; {remedy}, or add --force")
    made_folder(folder)
    for path, text in texts.items():
        with written_whole(path, replace=force) as new:
            new.write_text(text, encoding="utf-8")
    print("\n".join(f"wrote {visible(str(path))}" for path in texts))
    if note:
        print(note, file=sys.stderr)
    if of is not None:
        commands = _starts(next(iter(texts)), of, compiled=language == "c")
        print("\n" + "\n".join(f"  {visible(line)}" for line in commands))
        return
    print(f"\n  hil run {visible(str(folder / f'{module}.toml'))}\n  pytest {visible(str(folder / f'test_{module}.py'))}")
    if part != "experiment":
        print(f"  hil guide first-plugin   # what each line of {module}.py is for")


def _holds(path: Path, text: str) -> bool:
    with suppress(OSError, UnicodeDecodeError):
        return not path.is_symlink() and path.read_text(encoding="utf-8") == text
    return False


def _starts(path: Path, of: ExternalController, *, compiled: bool) -> list[str]:
    """Return the commands that start a program and its rig."""
    at = "tcp/127.0.0.1:7447" if of.kind == "zenoh" else "vcan0" if compiled else "rig0"
    uri = f"zenoh:{at}" if of.kind == "zenoh" else f"can:{'socketcan' if compiled else 'hil'}:{at}"
    program, source, codec = (shlex.quote(str(each)) for each in (path.with_suffix(""), path, path.parent / "hilrig.c"))
    build = [f"cc -std=c99 -O2 -o {program} {source} {codec}"] if compiled else []
    start = f"{'./' if path.parent == Path() else ''}{program}" if compiled else f"python {source}"
    end = f"# with the key: the first lines of {path}" if of.keyed else "# in another terminal"
    return [*build, f"hil rig {shlex.quote(of.argument)} --link {of.rig_link(uri)}", f"{start} {at}   {end}"]


def _program(stem: str, language: str, argument: str, kind: str, keyed: bool) -> tuple[ExternalController, dict[str, str], str]:
    """Return a controller as a program of its own, its files, and what to say of it; see `hil.cli.new_external`."""
    from hil.cli.new_external import external_controller, program_files
    from hil.compose import compose
    from hil.experiment import load_experiment

    named = load_experiment(argument)
    with Working(f"{named.name}: its loop"):
        loop = compose(named)
    of = external_controller(loop, argument, kind, keyed)  # type: ignore[arg-type]  # click knows the words
    note = f"note: {of.law.why_none}: the program answers zeros until you write its law" if of.law.why_none else ""
    return of, program_files(of, stem, language), note  # type: ignore[arg-type]


def files_of(part: str, module: str) -> dict[str, str]:
    """Return the files of a part, name and text, by the name of its module.

    Args:
        part: of `PARTS`.
        module: name of the user's module; the class is named after it.
    """
    from importlib import resources

    templates = Path(str(resources.files("hil") / "templates"))
    cls = "".join(word.capitalize() for word in module.split("_"))
    kept = {f"{part}.py.txt": f"{module}.py", f"{part}.toml": f"{module}.toml", f"test_{part}.py.txt": f"test_{module}.py"}
    return {
        new: re.sub(r"\bMine\b", cls, re.sub(r"\bmine\b", module, (templates / old).read_text(encoding="utf-8")))
        for old, new in kept.items()
        if (templates / old).is_file()
    }


def _is_taken(module: str) -> bool:
    """Return whether ``import module`` in a test would find Python's own module of this name, or an installed one."""
    import sysconfig
    from importlib.machinery import PathFinder

    from hil.plugins import OURS

    installed = [sysconfig.get_path(scheme) for scheme in ("purelib", "platlib")]
    return module in {*sys.stdlib_module_names, *OURS, "hil", "conftest"} or PathFinder.find_spec(module, installed) is not None


@click.command()
@click.argument("group", type=click.Choice(GROUPS))
@click.argument("kind")
@click.option("--parameter", "sets", multiple=True, type=CHANGE, metavar="KEY=VALUE", help="A key of its table; repeatable.")
@click.option("--in", "experiment", default="dc-motor-hinf", show_default=True, type=EXPERIMENT, metavar="EXPERIMENT",
              help="The experiment whose model a controller, and whose run a measure is checked with.")  # fmt: skip
@json_option()
def check(group: str, kind: str, sets: tuple[str, ...], experiment: str) -> None:
    """Check a plug-in and say what it has earned: hil check laws my_module:Mine --parameter p=0.3

    KIND is the name of an installed plug-in or module:Class of a file in this folder; of a link it is a URI. A rule that
    is broken gives one message and exit status 2.
    """
    from hil.plugins.user_plugins import words
    from plants.errors import PlantError
    from transport import TransportError

    no_keys = {"links": "a link's options stand in its URI", "measures": "a measure has no keys"}
    if sets and group in no_keys:
        raise HilError(f"--parameter: {no_keys[group]}")
    try:
        said = _earned(group, kind, sets, experiment)
    except (HilError, TransportError, KeyboardInterrupt):
        raise
    except BaseException as fault:  # whatever a plug-in raises
        text = str(fault).partition("\n")[0] if isinstance(fault, AssertionError | PlantError) else words(fault)
        raise HilError(f"check_{group[:-1]}: {kind}: {text}") from fault
    answer({"group": group, "kind": kind, "earned": said}, print_each_folded, said)


def _earned(group: str, kind: str, sets: tuple[str, ...], experiment: str) -> list[str]:
    """Return what a plug-in has earned, a sentence each; what it breaks is raised by the check of its group."""
    if group == "links":
        from transport import check_link, open_link

        return check_link(lambda: (open_link(kind, "rig"), open_link(kind, "controller")))
    if group == "measures":
        return _earned_by_measure(kind, experiment)
    from hil.experiment import parse_plugin

    made = parse_plugin(f"hil.{group}", kind, sets)  # type: ignore[arg-type]  # click knows the words
    if group == "plants":
        from plants import check_plant

        return check_plant(made, period_s=PERIOD_S) + _compared(made)
    from hil.plugins.checks import check_controller, check_law
    from hil.plugins.user_plugins import Designer

    if group == "laws":
        return check_law(made)
    if isinstance(made, Designer):
        return [f"{type(made).__name__} is a Designer: an experiment that names it solves its gains, and judges their loop"]
    from hil.compose import compose
    from hil.experiment import load_experiment

    return check_controller(made, compose(load_experiment(experiment), certify=False).model)


def _compared(plant: Any) -> list[str]:
    """Return what the comparison of a plant with its model finds, as before a run; none where it says that it has more.

    Raises:
        PlantError: the plant does not move as it says.
    """
    import numpy as np

    from design.controllers import LoopModel
    from hil.certify.conformance import plant_check, without_loop
    from plants.errors import PlantError
    from plants.parts.protocols import BeyondModel, HasDepartures

    if (isinstance(plant, BeyondModel) and plant.beyond_model()) or (isinstance(plant, HasDepartures) and plant.departures()):
        return []
    try:
        known = plant.model().discretise(PERIOD_S)
    except PlantError as error:
        return [f"a run compares it with its model at its own period ({error})"]
    A, B, C = (np.asarray(matrix) for matrix in (known.A, known.B, known.C))
    state, found = plant_check(without_loop(plant, LoopModel(A=A, B=B, C=C, period_s=PERIOD_S, tau_max=0, d_max=0)))
    if state == "refused":
        raise PlantError(str(found))
    return list(found) if state is None else [f"its loops are undecided: {found}"]


def _earned_by_measure(kind: str, experiment: str) -> list[str]:
    from hil.compose import compose
    from hil.experiment import load_experiment
    from hil.measure import made_of
    from hil.measure.check import check_measure
    from hil.measure.view import view_of
    from hil.pages.sections import check_section
    from hil.plugins import registry
    from hil.runtime.virtual import rehearsal

    made = made_of(registry.load("hil.measures", kind))
    loop = compose(load_experiment(experiment), certify=False)
    view = view_of(rehearsal(loop), loop.experiment, loop.rig)
    return check_measure(made, view) + check_section(made, view)
