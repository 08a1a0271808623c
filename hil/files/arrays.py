"""Matrices and gains from files: ``A = { file = "cart.mat", key = "A" }`` in the place of the numbers.

The files may come from anywhere: nothing is unpickled, no file makes more numbers than `MOST_NUMBERS`, and scipy reads a MATLAB
file in a process of its own, under limits. `read_columns` takes columns of numbers from a CSV file of another program.
"""

from __future__ import annotations

import csv
import io
import math
import os
import signal
import sys
import zipfile
from array import array
from collections.abc import Callable, Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hil.errors import HilError, located
from hil.files import open_regular, read_regular

_CHILD: Final = Path(__file__).with_name("mat_child.py")


def npy_of_mat(data: bytes, key: str, most_numbers: int) -> bytes:
    """Return a matrix of a MATLAB file, version 4 to 7, in numpy's format `.npy`; see `hil.files.mat_child`.

    Args:
        data: the file.
        key: name of the variable.
        most_numbers: the most that it may hold.

    Raises:
        HilError: the file is damaged, of another version, or holds no such matrix.
    """
    import subprocess  # other files are read here

    done = subprocess.run(
        [sys.executable, "-I", str(_CHILD), key, str(most_numbers)],  # -I: no folder of the user is on its path
        input=data, capture_output=True, env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    if done.returncode < 0:
        raise HilError(f"is no whole .mat file: scipy's reader ended by {signal.Signals(-done.returncode).name}")
    if done.returncode != 0:
        raise HilError(done.stderr.decode(errors="replace").strip()[-500:])
    return done.stdout


MAX_BYTES: Final = 16_000_000
MOST_NUMBERS: Final = 1_000_000
SUFFIXES: Final = (".npz", ".npy", ".csv", ".mat")


def numbers_from_file(table: dict[str, Any], field: str, folder: str, dimensions: int) -> list[Any]:
    """Return the numbers that a table ``{file, key}`` names, as nested lists.

    Args:
        table: ``file``, relative to the folder, that ends in .npz, .npy, .csv or .mat; ``key``, the name of the array in an
            .npz or .mat file, by default that of the field.
        field: name of the field that takes them.
        folder: where the experiment stands.
        dimensions: how many the field takes; a vector may be one row or one column of a matrix.

    Raises:
        HilError: naming the file and the key.
    """
    unknown = [key for key in table if key not in ("file", "key")]
    name, key = table.get("file"), table.get("key", field)
    if unknown or not isinstance(name, str) or not isinstance(key, str):
        raise HilError(f'expected numbers, or {{ file = "name.npz", key = {field!r} }} that holds them; got {table!r:.60}')
    path, suffix = Path(folder, name), Path(name).suffix.lower()
    if suffix not in SUFFIXES:
        raise HilError(f"{name!r:.80}: expected a name that ends in {', '.join(SUFFIXES)}")
    if suffix in (".csv", ".npy") and "key" in table:
        raise HilError(f"{name}: a {suffix} file holds one array, and no key {key!r}")
    data = read_regular(path, MAX_BYTES, f"a file of numbers ({suffix})")
    try:
        if suffix == ".csv":
            found = _of_csv(data)
        elif suffix == ".npy":
            found = _of_npy(data)
        else:
            found = (_of_npz if suffix == ".npz" else _of_mat)(data, key)
    except HilError as error:
        raise HilError(f"{path}: {error}") from error
    except Exception as error:  # numpy, zipfile and its three unpackers raise what they like for a file that is none
        raise HilError(f"{path}: is no whole {suffix} file: {error}") from error
    if found.size > MOST_NUMBERS:
        raise HilError(f"{path}: key {key!r}: {found.size} numbers; at most {MOST_NUMBERS}")
    if dimensions == 1 and max(found.shape, default=1) == found.size:
        found = found.ravel()
    if found.ndim != dimensions:
        raise HilError(f"{path}: key {key!r}: an array of shape {found.shape}; this field takes {dimensions} dimensions")
    listed: list[Any] = found.astype(np.float64).tolist()
    return listed


def _of_csv(data: bytes) -> NDArray[Any]:
    rows = []
    for number, line in enumerate(data.decode("utf-8-sig").splitlines(), 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            rows.append([float(cell) for cell in line.split(",")])
        except ValueError:
            raise HilError(f"line {number}: {line!r:.60} is no row of numbers") from None
        if len(rows[-1]) != len(rows[0]):
            raise HilError(f"line {number}: {len(rows[-1])} numbers, the first row has {len(rows[0])}")
        if len(rows) * len(rows[0]) > MOST_NUMBERS:  # before a list for every row takes fifty times the file
            raise HilError(f"line {number}: more than {MOST_NUMBERS} numbers")
    if not rows:
        raise HilError("holds no numbers")
    return np.array(rows)


def _of_npy(data: bytes) -> NDArray[Any]:
    head = io.BytesIO(data)
    version = np.lib.format.read_magic(head)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(head)
    _bounded(shape, dtype.kind)  # before memory is taken for it
    found: NDArray[Any] = np.load(io.BytesIO(data), allow_pickle=False)
    return found


def _of_npz(data: bytes, key: str) -> NDArray[Any]:
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        names = [name.removesuffix(".npy") for name in file.namelist()]
        if key not in names:
            raise HilError(f"has no key {key!r}; it has {_listed(names)}")
        with file.open(file.namelist()[names.index(key)]) as member:
            held = member.read(MAX_BYTES + 1)
    if len(held) > MAX_BYTES:
        raise HilError(f"key {key!r}: more than {MAX_BYTES} bytes")
    with located(f"key {key!r}", HilError):
        return _of_npy(held)


def _of_mat(data: bytes, key: str) -> NDArray[Any]:
    if "\0" in key:
        raise HilError(f"has no key {key!r}")
    return _of_npy(npy_of_mat(data, key, MOST_NUMBERS))


def _bounded(shape: tuple[int, ...], kind: str) -> None:
    if kind not in "fiub":
        raise HilError(f"holds an array of kind {kind!r}, expected real numbers")
    most = math.prod(max(int(length), 1) for length in shape)  # a million rows of no numbers are a million lists
    if most > MOST_NUMBERS or any(length < 0 for length in shape):
        raise HilError(f"an array of shape {tuple(shape)}; at most {MOST_NUMBERS} numbers")


def _listed(names: list[str]) -> str:
    return ", ".join(repr(name)[:40] for name in names[:20]) or "none"


MOST_BYTES = 256 << 20
MISSING = ("", "lost", "nan")


class Columns(NamedTuple):
    """What was read.

    Attributes:
        header: names of all columns, without their units.
        values: the columns that were picked, (rows, columns), NaN where an entry is missing.
        lines: of every row the line of the file, counted from 1.
        units: of the columns that were picked, what stands in brackets behind their names.
    """

    header: list[str]
    values: NDArray[np.float64]
    lines: NDArray[np.int64]
    units: list[str]


def read_columns(path: Path, what: str, picked: Callable[[list[str]], Sequence[str]]) -> Columns:
    """Read columns of a file whose first line names them, with units in brackets or without. Lines that begin with # are skipped.

    An empty line is skipped too, but where the file has one column: there it is a missing entry, unless nothing follows it. Where
    semicolons separate the names, numbers may have a decimal comma.

    Args:
        path: the file.
        what: what the file is, for messages.
        picked: the names of the columns to be read, from those that the file has.

    Raises:
        HilError: it cannot be read, is larger than `MOST_BYTES`, a row has another length than the first line, or an entry is
            no number; the message has the line.
    """
    numbers, lines = array("d"), array("q")  # a float in a list takes four times as much
    with open_regular(path, what) as file:
        if os.fstat(file.fileno()).st_size > MOST_BYTES:
            raise HilError(f"{path}: more than {MOST_BYTES} bytes, the limit of {what}")
        with located(f"{path}: is no CSV", OSError, UnicodeDecodeError, csv.Error):
            text = io.TextIOWrapper(file, "utf-8-sig", newline="")
            first = text.readline(1 << 20)
            separator = ";" if ";" in first and "," not in first else ","
            rows = csv.reader(chain([first], text), delimiter=separator, strict=True)
            heads = [name.partition("[") for name in next(rows, [])]
            header = [name.strip() for name, _, _ in heads]
            wanted = picked(header)
            if twice := next((name for name in wanted if header.count(name) > 1), ""):
                raise HilError(f"{path}: two columns are called {twice!r}, expected one")
            at = [header.index(name) for name in wanted]
            empty: array[int] = array("q")
            for row in rows:
                if not row:
                    if len(header) == 1:
                        empty.append(rows.line_num)
                    continue
                if row[0].lstrip().startswith("#"):
                    continue
                if len(header) == 1:
                    lines.extend(empty)
                    numbers.extend(repeat(math.nan, len(empty) * len(at)))
                    del empty[:]
                if len(row) != len(header):
                    comma = "; numbers have a decimal point" if len(header) == 1 else ""
                    raise HilError(f"{path}:{rows.line_num}: {len(row)} entries, the first line has {len(header)}{comma}")
                lines.append(rows.line_num)
                for i in at:
                    entry = row[i].replace(",", ".") if separator == ";" else row[i]
                    try:
                        numbers.append(math.nan if entry.strip().lower() in MISSING else float(entry))
                    except ValueError:
                        raise HilError(f"{path}:{rows.line_num}: {row[i]!r:.40} is no number") from None
    units = [heads[i][2].partition("]")[0].strip() for i in at]
    return Columns(header, np.frombuffer(numbers).reshape(len(lines), len(at)), np.frombuffer(lines, np.int64), units)
