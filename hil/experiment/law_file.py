"""A network law in a file of its own, as `hil identify law` writes one: ``law = { file = "law.toml" }``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hil.errors import HilError
from hil.files.regular import read_regular
from hil.files.toml_text import parse_toml

MAX_BYTES = 1_000_000
BESIDE = "fit"
"""The table of a law's file that says how it was found; a run does not read it."""


def names_law_file(raw: Any) -> bool:
    """Return whether a table of a law names a file and nothing else."""
    return isinstance(raw, dict) and raw.keys() == {"file"}


def read_law_file(name: Any, folder: str) -> dict[str, Any]:
    """Return the table of a network law from a file.

    Args:
        name: the file; a relative one counts from the folder.
        folder: where the experiment stands.

    Raises:
        HilError: it is no text, cannot be read, is no TOML, or has no law.
    """
    if not isinstance(name, str):
        raise HilError(f"file: expected the name of a law's file, got {name!r:.60}")
    path = Path(folder) / name
    try:
        table = parse_toml(read_regular(path, MAX_BYTES, "a file of a network law").decode())
    except UnicodeDecodeError:
        raise HilError(f"file: {path}: is no text") from None
    except ValueError as error:
        raise HilError(f"file: {path}: not valid TOML: {error}") from error
    except HilError as error:
        raise HilError(f"file: {error}") from error
    table.pop(BESIDE, None)
    if not isinstance(table.get("kind"), str):
        raise HilError(f"file: {path}: kind: missing; expected a network law, as `hil identify law` writes one")
    return table
