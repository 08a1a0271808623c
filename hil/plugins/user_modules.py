"""Plug-ins without packaging: ``kind = "my_module:Cart"`` is the class of a Python file beside the experiment.

The module runs under a name that holds the digest of its text: two experiments may have modules of one name, a file that was
changed is another module, and a verdict on its class is a verdict on that text.
"""

from __future__ import annotations

import copyreg
import io
import os
import pickle
import re
import sys
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final

from hil.errors import HilError
from hil.files import read_regular
from hil.plugins.process_guard import WATCH, ProcessState, refuse_calls_from

MAX_BYTES: Final = 1_000_000
_PREFIX: Final = "hil_own_"
_DIGITS: Final = 16
_SHAPE: Final = re.compile(r"([A-Za-z_]\w*):([A-Za-z_]\w*)", re.ASCII)


def is_own(kind: str) -> bool:
    """Return whether a kind names a class of the user's own file, and no installed plug-in."""
    return ":" in kind


def load_own(kind: str, folder: str | os.PathLike[str]) -> Any:
    """Return what a kind names, from the experiment's folder, else from the working folder.

    Args:
        kind: ``module:Name``.
        folder: where the experiment stands.

    Raises:
        HilError: no such file, a file that cannot be run, or nothing of that name in it.
    """
    said = _SHAPE.fullmatch(kind)
    if said is None:
        raise HilError(f"{kind!r:.80}: expected module:Class, such as my_module:Cart for the class Cart of my_module.py")
    file, name = f"{said[1]}.py", said[2]
    folders = list(dict.fromkeys(Path(base).resolve() for base in (folder, ".")))
    path = next((base / file for base in folders if os.path.isfile(base / file)), None)  # also a name that none can have
    if path is None:
        raise HilError(f"{kind!r}: there is no {file} in {' or '.join(map(str, folders))}")
    module = _module(path)
    if name not in vars(module):
        there = sorted(key for key, value in vars(module).items() if _made_in(value, module))
        raise HilError(f"{kind!r}: {path} has no {name!r}; it has {', '.join(there) or 'no class or function'}")
    return vars(module)[name]


def written_in(cls: object) -> tuple[str, str] | None:
    """Return file name and first digits of the SHA-256 of the own module that a class was written in, None for any other."""
    module = sys.modules.get(cls.__module__) if isinstance(cls, type) else None
    if module is None or not module.__name__.startswith(_PREFIX) or module.__file__ is None:
        return None
    return Path(module.__file__).name, module.__name__.removeprefix(_PREFIX)[:_DIGITS]


def _module(path: Path, expected: str | None = None) -> ModuleType:
    """Return the module of a file, run once for every text of it."""
    text = read_regular(path, MAX_BYTES, "a Python module")
    name = f"{_PREFIX}{sha256(text).hexdigest()[:_DIGITS]}_{path.stem}"
    if expected is not None and name != expected:
        raise HilError(f"{path}: was changed since the run was composed")
    if name in sys.modules:
        sys.modules[name].__file__ = str(path)  # of the files of one text, the one that was read last
        return sys.modules[name]
    module = ModuleType(name)
    module.__file__ = str(path)
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))  # behind everything that is installed: what it imports from its own folder
    sys.modules[name] = module  # dataclasses look their module up while it runs
    refuse_calls_from(_PREFIX)
    WATCH.get().begin(str(path))
    before = ProcessState.now()
    try:
        exec(compile(text, str(path), "exec"), vars(module))
        changes = before.changes()
        if changes:
            raise HilError(f"{path}: {'; '.join(changes)}; a module that is loaded leaves its process as it was")
    except BaseException as error:  # whatever a user's module raises when it runs
        del sys.modules[name]
        before.restore()
        if isinstance(error, HilError):
            raise
        if isinstance(error, KeyboardInterrupt):
            raise
        import traceback

        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line = lines[-1] if lines else error.lineno if isinstance(error, SyntaxError) else None
        where = f"{path}, line {line}" if line else str(path)
        message = error.msg if isinstance(error, SyntaxError) else error
        raise HilError(f"{where}: {type(error).__name__}: {message}") from error
    for value in vars(module).values():
        if isinstance(value, type) and _made_in(value, module):
            copyreg.pickle(value, _reduce)  # another process has to find the file before the class
    return module


def _made_in(value: object, module: ModuleType) -> bool:
    return isinstance(value, type | FunctionType) and value.__module__ == module.__name__


def _reduce(made: Any) -> tuple[Any, ...]:
    module = sys.modules[type(made).__module__]
    kept = io.BytesIO()
    pickler = pickle.Pickler(kept)
    pickler.dispatch_table = {}  # the plain way from here on: `_revive` has brought the module by then
    pickler.dump(made)
    path = Path(str(module.__file__))
    return _revive, (str(path), module.__name__, kept.getvalue())


def _revive(path: str, name: str, kept: bytes) -> Any:
    if name not in sys.modules:
        _module(Path(path), name)
    return pickle.loads(kept)


OURS: Final = ("design", "plants", "transport")
ROOT: Final = Path(__file__).resolve().parents[2]
"""The folder that holds hil and its three packages: a checkout, or `site-packages`."""
OUR_FOLDERS: Final = tuple(f"{ROOT / name}/" for name in ("hil", *OURS))

REMEDY: Final = "rename it, or start Python from another folder or with python -P (pytest: --import-mode=importlib)"


def shadows() -> dict[str, str]:
    """Return the files that stand in the place of our packages, by package; what is missing is an empty text."""
    found = {}
    for name in OURS:
        try:
            spec = find_spec(name)
        except ValueError:  # a module without a spec, such as one that a test has put there
            spec = None
        origin = spec.origin if spec is not None else None
        if origin is None or Path(origin).resolve().parent != ROOT / name:
            found[name] = origin or ""
    return found


def refuse_shadowed_packages() -> None:
    """Refuse to go on with a foreign `design`, `plants` or `transport`.

    A module of the name `design`, `plants` or `transport` in a user's folder takes their place.

    Raises:
        HilError: a line for each file that shadows one of ours, with what helps.
    """
    found = shadows()
    if found:
        lines = [f"{path or 'no module'} shadows hilrig's package {name!r}" for name, path in found.items()]
        raise HilError("\n".join([*lines, REMEDY]))


def is_ours(made: object) -> bool:
    """Return whether the class of an object stands in our own packages, under its name."""
    cls = type(made)
    module = sys.modules.get(cls.__module__)
    found = getattr(module, cls.__qualname__, None)
    file = getattr(module, "__file__", None)
    return found is cls and str(file).startswith(OUR_FOLDERS)
