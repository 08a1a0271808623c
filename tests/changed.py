"""Print the tests of what changed since main: ``make check`` runs them.

    python -m tests.changed

Of each changed file these are: the file itself if it is one of tests or holds doctests, the folder that mirrors its room or else
the one above, and the test files that import it. What changed is what differs from where this branch left main, and what git does
not know yet.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("hil", "plants", "transport", "design")
GUIDE = "tests/contract/test_readme.py"


def changed(root: Path = ROOT, since: str = "main") -> list[str]:
    """Return the files that have changed since this branch left another one, and new ones, from the top of the checkout."""
    base = [*_git(root, "merge-base", "HEAD", since), "HEAD"][0]
    names = [*_git(root, "diff", "--name-only", base), *_git(root, "ls-files", "--others", "--exclude-standard")]
    return sorted({name for name in names if (root / name).is_file()})


def before(root: Path = ROOT) -> str | None:
    """Return the commit at which the change that stands here began: where its branch left main, on main the one before it.

    None where git has neither, as in a clone that is one commit deep.
    """
    head = _git(root, "rev-parse", "HEAD")
    for main in ("main", "origin/main"):
        base = _git(root, "merge-base", "HEAD", main)
        if base and base != head:
            return base[0]
    return next(iter(_git(root, "rev-parse", "--verify", "--quiet", "HEAD~1")), None)


def _git(root: Path, *words: str) -> list[str]:
    done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True)
    return done.stdout.splitlines() if done.returncode == 0 else []


def chosen_for(names: Iterable[str], root: Path = ROOT) -> list[str]:
    """Return what pytest is asked to run for changed files: files and folders, none inside another."""
    files = {path.relative_to(root).as_posix(): path.read_text() for path in (root / "tests").rglob("test_*.py")}
    found: set[str] = set()
    for name in names:
        path = Path(name)
        if name in files:
            found.add(name)
        elif path.suffix == ".md":
            found.add(GUIDE)
        elif path.suffix == ".py":
            found |= _of_module(path, files, root)
    return sorted(name for name in found if not any(parent.as_posix() in found for parent in Path(name).parents))


def _of_module(path: Path, files: dict[str, str], root: Path) -> set[str]:
    """Return the tests that import a module, those of its room, and its doctests."""
    *package, name = path.with_suffix("").parts if path.stem != "__init__" else path.parts[:-1]
    module, parent = re.escape(".".join([*package, name])), re.escape(".".join(package))
    said = re.compile(rf"^\s*(from {module} |import {module}\b|from {parent} import .*\b{name}\b)", re.M)
    found = {file for file, text in files.items() if said.search(text)}
    if path.parts[0] in PACKAGES:
        room = Path("tests", *path.parts[:-1])
        mirrors = [folder for folder in (room, *room.parents) if len(folder.parts) > 2 and (root / folder).is_dir()]
        found |= {folder.as_posix() for folder in mirrors[:1]}
        if ">>>" in (root / path).read_text():
            found.add(path.as_posix())
        return found | {f"{room.as_posix()}/test_{path.stem}.py"} & {*files}
    return found | {path.parent.as_posix()} if path.name == "conftest.py" and len(path.parts) > 2 else found


if __name__ == "__main__":
    print(*chosen_for(changed()), sep="\n")
