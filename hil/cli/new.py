"""``hil new``: a part of the user's own that runs as it is written, with an experiment and a test of it."""

from __future__ import annotations

import keyword
import re
from pathlib import Path

import click

from hil.errors import HilError

PARTS = ("plant", "controller", "law", "measure", "experiment")


@click.command()
@click.argument("part", type=click.Choice(PARTS))
@click.argument("name")
@click.option("-o", "--output", "folder", type=click.Path(file_okay=False, path_type=Path), default=Path("."),
              help="Folder to write to; made where it is not there. The working folder by default.")  # fmt: skip
@click.option("--force", is_flag=True, help="Replace files that are there.")
def command(part: str, name: str, folder: Path, force: bool) -> None:
    """Write a plant, controller, law, measure or experiment of your own: hil new plant cart

    Makes cart.py with the class Cart, the experiment cart.toml that runs it, and the pytest file test_cart.py. All run as they
    are; change them from there.
    """
    from hil.cli.terminal import visible
    from hil.files.outputs import written_whole

    if not re.fullmatch(r"[a-z][a-z0-9_-]{0,63}", name, re.ASCII):
        raise HilError(f"NAME: {name!r:.80}: expected lower-case letters, digits, _ or -: hil new {part} my_{part}")
    module = name.replace("-", "_")
    if keyword.iskeyword(module) or _is_taken(module):
        raise HilError(f"NAME: {name!r}: Python has a module or a word of this name; take another: hil new {part} my_{module}")
    texts = {folder / file: text for file, text in files_of(part, module).items()}
    there = [path for path in texts if path.exists() or path.is_symlink()]
    if there and not force:
        raise HilError(f"{there[0]}: exists already; choose another name, or add --force")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise HilError(f"{folder}: cannot be made: {error.strerror or error}") from error
    for path, text in texts.items():
        with written_whole(path, replace=force) as new:
            new.write_text(text, encoding="utf-8")
    experiment = folder / f"{module}.toml"
    print("\n".join(f"wrote {visible(str(path))}" for path in texts))
    print(f"\n  hil run {visible(str(experiment))}\n  pytest {visible(str(folder / f'test_{module}.py'))}")
    if part != "experiment":
        print(f"  hil guide first-plugin   # what each line of {module}.py is for")


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
    import sys
    import sysconfig
    from importlib.machinery import PathFinder

    installed = [sysconfig.get_path(scheme) for scheme in ("purelib", "platlib")]
    return module in sys.stdlib_module_names or PathFinder.find_spec(module, installed) is not None
