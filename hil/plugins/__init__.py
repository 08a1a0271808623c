"""Plug-ins and users' modules: found, made, checked; and the protocols that they fulfil. Here are those without packaging.

``kind = "my_module:Cart"`` is the class of a Python file beside the experiment. The module runs under a name that holds the
digest of its text: two experiments may have modules of one name, a file that was changed is another module, and a verdict on its
class is a verdict on that text.

It must leave as it was: working folder, streams, handlers of signals, environment, the process itself. A call that would end,
copy or replace the process is an error of that module: ``os._exit(0)`` ends a run, a worker of a sweep or a whole pytest without
a word and with status 0; a fork returns to hil twice. This is no sandbox: it says what a module does by mistake. What it does on
purpose, `hil.cli.guard` sees.
"""

from __future__ import annotations

import copyreg
import io
import os
import pickle
import re
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from contextvars import ContextVar
from functools import wraps
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any, Final, NamedTuple, Protocol

from hil.errors import ENDING, HilError
from hil.files import read_regular

STREAMS: Final = {0: "standard input", 1: "standard output", 2: "standard error"}


class ProcessState(NamedTuple):
    """What other code of this process leans on."""

    folder: str | None
    files: Mapping[int, tuple[int, int] | None]
    streams: Mapping[str, Any]
    handlers: Mapping[int, Any]
    blocked: frozenset[int]
    environment: Mapping[str, str]

    @classmethod
    def now(cls) -> ProcessState:
        """Return how this process is at present."""
        return cls(
            folder=_folder(),
            files={number: _file(number) for number in STREAMS},
            streams={"stdout": sys.stdout, "stderr": sys.stderr},
            handlers={number: signal.getsignal(number) for number in ENDING},
            blocked=frozenset(signal.pthread_sigmask(signal.SIG_BLOCK, ())),
            environment=dict(os.environ),
        )

    def changes(self) -> list[str]:
        """Return what is not as it was, each as a clause with its remedy's name; variables that were added are no change."""
        now = ProcessState.now()
        gone = sorted(self.environment.keys() - now.environment.keys())
        said: list[str | bool] = [
            self.folder != now.folder and "it changes the working folder (os.chdir)",
            *(self.files[n] != now.files[n] and f"it closes or replaces {what}" for n, what in STREAMS.items()),
            *(self.streams[name] is not now.streams[name] and f"it replaces sys.{name}" for name in self.streams),
            *(
                self.handlers[n] != now.handlers[n] and f"it changes the handler of {signal.Signals(n).name}"
                for n in self.handlers
            ),
            bool((now.blocked - self.blocked) & {*ENDING}) and "it blocks signals that end hil",
            bool(gone) and f"it removes {gone[0]}{' and others' * (len(gone) > 1)} from the environment",
        ]
        return [each for each in said if isinstance(each, str)]

    def restore(self) -> None:
        """Put back what can be put back; a descriptor that was closed cannot."""
        if self.folder is not None and self.folder != _folder():
            os.chdir(self.folder)
        sys.stdout, sys.stderr = self.streams["stdout"], self.streams["stderr"]
        signal.pthread_sigmask(signal.SIG_SETMASK, self.blocked)
        if threading.current_thread() is threading.main_thread():  # no other may set handlers
            for number, handler in self.handlers.items():
                if handler is not None:
                    signal.signal(number, handler)
        os.environ.update({name: value for name, value in self.environment.items() if name not in os.environ})


def _or_none(ask: Callable[[], Any]) -> Any:
    try:
        return ask()
    except OSError:
        return None


def _folder() -> str | None:
    return _or_none(os.getcwd)  # type: ignore[no-any-return]


def _file(number: int) -> tuple[int, int] | None:
    about = _or_none(lambda: os.fstat(number))
    return None if about is None else (about.st_dev, about.st_ino)


CALLS: Final = ("_exit", "abort", "fork", "forkpty", "execv", "execve")


def refuse_calls_from(prefix: str) -> None:
    """Let these calls raise a RuntimeError where a module of such a name, or a file beside one, makes them.

    Args:
        prefix: of the names of modules.
    """
    for name in CALLS:
        call = getattr(os, name)
        if not isinstance(getattr(call, "__wrapped__", None), type(os.getpid)):  # not yet
            setattr(os, name, _refusing(call, prefix))


def _refusing(call: Callable[..., Any], prefix: str) -> Callable[..., Any]:
    @wraps(call)
    def refuse(*arguments: Any, **named: Any) -> Any:
        frame = sys._getframe()
        while frame.f_back is not None and frame.f_globals.get("__name__") in ("os", __name__):  # os.execvp and its kin
            frame = frame.f_back
        files = [str(module.__file__) for name, module in sys.modules.items() if name.startswith(prefix)]
        if os.path.dirname(frame.f_code.co_filename) in map(os.path.dirname, files):
            does = "would end, copy or replace the process of hil itself"
            raise RuntimeError(f"os.{call.__name__} {does}: raise an exception, or start another with subprocess")
        return call(*arguments, **named)

    return refuse


class Watch(Protocol):
    """Receives what it cannot see from outside."""

    def begin(self, module: str) -> None:
        """Watch from here: the first line of a module, named by its file, is next."""

    def stopping(self) -> None:
        """A signal was heeded: what ends now ends in order, and closes its log."""


class _Unwatched:
    def begin(self, module: str) -> None:
        pass

    def stopping(self) -> None:
        pass


WATCH: Final[ContextVar[Watch]] = ContextVar("who watches this process", default=_Unwatched())  # noqa: B039 (it has no state)


MAX_BYTES: Final = 1_000_000
_PREFIX: Final = "hil_own_"
_DIGITS: Final = 16


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
    said = re.fullmatch(r"([A-Za-z_]\w*):([A-Za-z_]\w*)", kind, re.ASCII)
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
        message = error.msg if isinstance(error, SyntaxError) else text_of(error)
        raise HilError(f"{where}: {type(error).__name__}: {message}") from error
    for value in vars(module).values():
        if isinstance(value, type) and _made_in(value, module):
            copyreg.pickle(value, _reduce)  # another process has to find the file before the class
    return module


def text_of(error: BaseException) -> str:
    """Return what an exception of a user's code says, also where its class cannot say it."""
    try:
        return str(error)
    except Exception as fault:
        return f"(its __str__ raises {type(fault).__name__})"


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


def is_ours(part: object) -> bool:
    """Return whether the class of an object stands in our own packages, under its name."""
    cls = type(part)
    module = sys.modules.get(cls.__module__)
    found = getattr(module, cls.__qualname__, None)
    file = getattr(module, "__file__", None)
    return found is cls and str(file).startswith(OUR_FOLDERS)
