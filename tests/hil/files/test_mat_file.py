"""MATLAB's files: read as scipy writes them, in a process of its own; refused where they are damaged."""

from __future__ import annotations

import io
import random
import struct
import subprocess
import sys
import warnings
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from hil.errors import HilError
from hil.files import mat_child
from hil.files.arrays import npy_of_mat

MOST = 100_000
NUMBERS: dict[str, Any] = {
    "double": np.array([[1.0, np.nan, -0.05], [0.0, 2.0, 1e300]]), "single": np.float32([[1.5], [2.5]]),
    "flag": np.array([[True, False]]),
    "cube": np.arange(24.0).reshape(2, 3, 4), "empty": np.empty((0, 3)), "one": np.array([[7.0]]), "row": np.arange(3),
    "bytes": np.array([[1, 2], [3, 100]], dtype="u1"),
}  # fmt: skip
OTHERS = {"c": np.array([[1j]]), "words": "abc", "cells": np.array([1, "a"], dtype=object), "fields": {"x": 1.0}}


def saved(contents: dict[str, Any], **how: Any) -> bytes:
    out = io.BytesIO()
    savemat(out, contents, **how)
    return out.getvalue()


def read(data: bytes, key: str) -> Any:
    """In a process of its own, as an experiment's file is."""
    return np.load(io.BytesIO(npy_of_mat(data, key, MOST)), allow_pickle=False)


def npy_here(data: bytes, key: str, most_numbers: int) -> bytes:
    """What `npy_of_mat` returns or raises, without its process, whose start takes most of the time."""
    with warnings.catch_warnings():
        found = mat_child.npy_or_reason(data, key, most_numbers)
    if isinstance(found, str):
        raise HilError(found)
    return found


def read_here(data: bytes, key: str) -> Any:
    return np.load(io.BytesIO(npy_here(data, key, MOST)), allow_pickle=False)


@pytest.mark.parametrize("packed", [False, True])
def test_numbers_are_read_as_they_were_written_and_nothing_else_is(packed: bool) -> None:
    data = saved(NUMBERS | OTHERS, do_compression=packed)
    for name, expected in NUMBERS.items():
        array = (read if name == "cube" else read_here)(data, name)
        np.testing.assert_array_equal(array, np.atleast_2d(expected), err_msg=name)
        assert array.dtype == expected.dtype or name == "flag", name
    for name, group in {"fields": "struct", "words": "char", "cells": "cell"}.items():
        with pytest.raises(HilError, match=f"key '{name}': holds {group}, expected a full matrix of real numbers"):
            (read if name == "fields" else read_here)(data, name)
    assert read_here(data, "c").dtype.kind == "c"  # refused by its reader, as in a file of numpy


def test_version_4_is_read_in_both_byte_orders() -> None:
    np.testing.assert_array_equal(read_here(saved({"A": NUMBERS["double"]}, format="4"), "A"), NUMBERS["double"])
    big = struct.pack(">5i", 1000, 1, 2, 0, 2) + b"A\0" + struct.pack(">2d", 0.5, 4.0)
    np.testing.assert_array_equal(read_here(big, "A"), [[0.5, 4.0]])


@pytest.mark.parametrize("cut", [20, 130, 190, -1])
def test_what_is_cut_is_refused(cut: int) -> None:
    with pytest.raises(HilError, match=r"is no whole \.mat file|has no key 'A'"):
        read_here(saved({"A": NUMBERS["double"]})[:cut], "A")


def test_what_unpacks_to_too_much_is_refused_before_its_numbers_are_read() -> None:
    with pytest.raises(HilError, match=r"key 'A': an array of shape \(5000, 100\); at most 100000 numbers"):
        read(saved({"A": np.zeros((5000, 100))}, do_compression=True), "A")


def test_damaged_files_end_the_reader_and_never_this_process() -> None:
    """scipy alone ends its process (SIGSEGV) on some of a few hundred such files."""
    whole, draw = saved(NUMBERS | OTHERS), random.Random(3)
    for _ in range(3):  # each is a process; `make test-hostile` has thousands
        data = bytearray(whole)
        for _ in range(draw.randint(1, 6)):
            data[draw.randrange(len(data))] = draw.choice((0, 1, 127, 128, 255))
        try:
            assert read(bytes(data), "double").size <= MOST
        except HilError as error:
            assert "Traceback" not in str(error)


def test_a_reader_that_crashes_is_one_message(monkeypatch: pytest.MonkeyPatch, tmp_path: Any) -> None:
    crash = tmp_path / "crash.py"
    crash.write_text("import os, signal; os.kill(os.getpid(), signal.SIGSEGV)")
    monkeypatch.setattr("hil.files.arrays._CHILD", crash)
    with pytest.raises(HilError, match=r"is no whole \.mat file: scipy's reader ended by SIGSEGV"):
        read(b"", "A")


def test_its_process_is_limited() -> None:
    """What the process may take, as it says after it has read a file."""
    program = (
        f"import runpy, resource, sys; m = runpy.run_path({mat_child.__file__!r}); m['main']('A', 1);"
        "print([resource.getrlimit(w)[1] for w in (resource.RLIMIT_AS, resource.RLIMIT_CPU, resource.RLIMIT_CORE)])"
    )
    done = subprocess.run([sys.executable, "-I", "-c", program], input=b"", capture_output=True, check=True)
    assert done.stdout.decode().strip() == f"[{mat_child.MOST_MEMORY}, {mat_child.MOST_CPU_S}, 0]"
