"""Matrices and gains from files: the numbers, and what a foreign file may not do."""

from __future__ import annotations

import io
import struct
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

import hil
from hil.errors import HilError
from hil.experiment import shipped
from hil.files import arrays as array_files
from hil.files.arrays import numbers_from_file, read_columns
from tests.hil.files.test_mat_file import npy_here

A = np.array([[0.0, 1.0], [0.0, -2.0]])


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    np.savez(tmp_path / "cart.npz", A=A, B=[[0.0], [1.0]], flag=np.array(["x"], dtype=object))
    savemat(tmp_path / "cart.mat", {"C": [[1.0, 0.0]], "words": "abc", "cells": np.array([1, "a"], dtype=object)})
    savemat(tmp_path / "packed.mat", {"K": np.full((1, 1), -0.25)}, do_compression=True)
    savemat(tmp_path / "old.mat", {"K": np.full((1, 1), -0.25)}, format="4")
    np.save(tmp_path / "K.npy", np.array([[-0.25]]))
    (tmp_path / "K.csv").write_text("# gain\n-0.25\n")
    (tmp_path / "exp.toml").write_text(shipped()["dc-motor-hinf"].read_text())
    return tmp_path


def test_the_numbers_of_files_run_and_stand_in_the_log(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(array_files, "npy_of_mat", cache(array_files.npy_of_mat))  # a process for each matrix, not for each use
    plant = {"kind": "state-space"} | {name: {"file": file} for name, file in (("A", "cart.npz"), ("B", "cart.npz"))}
    plant["C"] = {"file": "cart.mat", "key": "C"}
    gains = []
    for gain in ({"file": "K.csv"}, {"file": "K.npy"}, {"file": "packed.mat", "key": "K"}, {"file": "old.mat", "key": "K"}):
        controller = {"kind": "local", "gain": gain}
        changes: dict[str, Any] = {"plant": plant, "controller": controller, "duration": 1, "limits.state": {}}
        experiment = hil.load_experiment(folder / "exp.toml", **changes)
        gains.append(experiment.resolved()["controller"]["gain"])
        assert experiment.resolved()["plant"]["A"] == A.tolist()
    assert gains == [[[-0.25]]] * 4
    log = folder / "a.mcap"
    assert hil.run(experiment, log=log).summary["certificate"]["state"] == "certified"
    assert hil.verify(log).difference is None  # the log needs no file but itself


def _bomb(path: Path) -> None:
    inside = struct.pack("<II", 14, 40_000_000) + bytes(40_000_000)
    packed = zlib.compress(inside, 9)
    head = b"MATLAB 5.0 MAT-file".ljust(124) + struct.pack("<H", 0x0100) + b"IM"
    path.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)


def _huge_npz(path: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**12,)})
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("A.npy", head.getvalue())


def _encrypted(path: Path) -> None:
    np.savez(path, A=A)
    data = path.read_bytes()
    for mark, at in ((b"PK\3\4", 6), (b"PK\1\2", 8)):  # the flag of the member, and of its entry in the directory
        data = data[: data.index(mark) + at] + b"\1" + data[data.index(mark) + at + 1 :]
    path.write_bytes(data)


def _damaged_lzma(path: Path) -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_LZMA) as file:
        file.writestr("A.npy", bytes(100))
    data = path.read_bytes()
    path.write_bytes(data[:44] + b"\xff" + data[45:])  # the first byte of its stream is 0


def test_of_many_keys_twenty_are_named(folder: Path) -> None:
    np.savez(folder / "many.npz", **{f"k{i:02d}": np.zeros(1) for i in range(25)})
    with pytest.raises(HilError, match=r"has no key 'K'; it has 'k00', .*'k19'$"):
        numbers_from_file({"file": "many.npz"}, "K", str(folder), 1)


def test_a_vector_is_a_row_or_a_column_and_what_is_too_much_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert numbers_from_file({"file": "cart.npz", "key": "B"}, "B", str(folder), 1) == [0.0, 1.0]
    with pytest.raises(HilError, match=r"K\.csv: a \.csv file holds one array, and no key 'K'"):
        numbers_from_file({"file": "K.csv", "key": "K"}, "K", str(folder), 2)
    with pytest.raises(HilError, match=r"cart\.mat: has no key 'C\\x00'"):
        numbers_from_file({"file": "cart.mat", "key": "C\0"}, "K", str(folder), 2)
    (folder / "four.csv").write_text("\ufeff1,2\n3,4\n")  # as spreadsheets begin a file of UTF-8
    monkeypatch.setattr(array_files, "MOST_NUMBERS", 4)
    assert numbers_from_file({"file": "four.csv"}, "K", str(folder), 2) == [[1.0, 2.0], [3.0, 4.0]]
    monkeypatch.setattr(array_files, "MOST_NUMBERS", 3)
    with pytest.raises(HilError, match="line 2: more than 3 numbers"):
        numbers_from_file({"file": "four.csv"}, "K", str(folder), 2)
    np.savez_compressed(folder / "zeros.npz", K=np.zeros(1000))
    monkeypatch.setattr(array_files, "MAX_BYTES", 1000)
    with pytest.raises(HilError, match="key 'K': more than 1000 bytes"):
        numbers_from_file({"file": "zeros.npz"}, "K", str(folder), 1)


HOSTILE: dict[str, tuple[Callable[[Path], object], str]] = {
    "bomb.mat": (_bomb, r"is no whole \.mat file"),
    "huge.npz": (_huge_npz, r"key 'A': an array of shape \(1000000000000,\); at most 1000000 numbers"),
    "pickle.npz": (lambda p: np.savez(p, A=np.array([{}], dtype=object)), "key 'A': holds an array of kind 'O', expected real"),
    "complex.npz": (lambda p: np.savez(p, A=np.array([1j])), "key 'A': holds an array of kind 'c'"),
    "other.npz": (lambda p: np.savez(p, B=A), "has no key 'A'; it has 'B'"),
    "encrypted.npz": (_encrypted, r"is no whole \.npz file: File 'A.npy' is encrypted"),
    "lzma.npz": (_damaged_lzma, r"is no whole \.npz file: Corrupt input data"),
    "torn.npz": (lambda p: p.write_bytes(b"PK\3\4 no zip"), r"is no whole \.npz file"),
    "text.mat": (lambda p: savemat(p, {"A": "abc"}), "key 'A': holds char, expected a full matrix"),
    "other.mat": (lambda p: savemat(p, {"B": A}), "has no key 'A'; it has 'B'"),
    "torn.mat": (lambda p: p.write_bytes(b"MATLAB 5.0".ljust(126) + b"IM\x0e\0\0\0"), r"is no whole \.mat file|has no key 'A'"),
    "new.mat": (lambda p: p.write_bytes(b"MATLAB 7.3 MAT-file"), "is a MATLAB 7.3 file; save it with -v7"),
    "ragged.csv": (lambda p: p.write_text("1,2\n3\n"), "line 2: 1 numbers, the first row has 2"),
    "words.csv": (lambda p: p.write_text("1,x\n"), "line 1: '1,x' is no row of numbers"),
    "empty.csv": (lambda p: p.write_text("\n"), "holds no numbers"),
    "large.csv": (lambda p: p.write_bytes(b"1\n" * (array_files.MAX_BYTES // 2 + 1)), "more than 16000000 bytes"),
    "matrix.txt": (lambda p: p.write_text("1"), r"expected a name that ends in \.npz, \.npy, \.csv, \.mat"),
    "missing.npz": (lambda p: None, "cannot be read: No such file"),
    "folder.npz": (lambda p: p.mkdir(), "is a folder"),
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_file_that_is_none_is_refused_by_its_name_and_key(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    make, reported = HOSTILE[name]
    if name != "bomb.mat":  # nothing of the others is unpacked
        monkeypatch.setattr(array_files, "npy_of_mat", npy_here)
    make(tmp_path / name)
    with pytest.raises(HilError, match=rf"{name}.*: {reported}|'{name}': {reported}"):
        numbers_from_file({"file": name}, "A", str(tmp_path), 2)


def test_empty_lines_take_no_memory(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a,b\n1,2\n" + "\n" * 100_000 + "3,4\n")
    tracemalloc.start()
    found = read_columns(tmp_path / "a.csv", "a table", lambda header: header)
    assert tracemalloc.get_traced_memory()[1] < 400_000
    tracemalloc.stop()
    assert found.values.tolist() == [[1.0, 2.0], [3.0, 4.0]] and found.lines.tolist() == [2, 100_003]


def test_of_two_columns_of_one_name_none_is_taken(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("a,b,b [V],c,c\n1,2,3,4,5\n")
    assert read_columns(tmp_path / "a.csv", "a table", lambda header: ["a"]).values.tolist() == [[1.0]]
    with pytest.raises(HilError, match=r"a\.csv: two columns are called 'b', expected one"):
        read_columns(tmp_path / "a.csv", "a table", lambda header: ["a", "b"])


def test_a_fault_of_a_file_stands_with_its_field(folder: Path) -> None:
    wrong = {"plant": {"kind": "state-space", "A": {"file": "cart.npz", "key": "Q"}, "B": {"fil": 1}, "C": [[1.0]]}}
    with pytest.raises(HilError, match=r"plant\.A: .*: has no key 'Q'; it has 'A', 'B', 'flag'\n.*plant\.B: expected numb"):
        hil.load_experiment(folder / "exp.toml", **wrong)
    with pytest.raises(HilError, match=r"controller\.gains: .*shape \(1, 1\); this field takes 4 dimensions"):
        hil.load_experiment(folder / "exp.toml", controller={"kind": "send-all", "gains": {"file": "K.csv"}})


@pytest.mark.parametrize(
    ("key", "value", "fault"),
    [
        ("inputs", [{"name": "force", "unit": "N"}], 'inputs[0]: expected a list, got a table; it is written ["name", "unit"]'),
        ("inputs", ["force", "N"], 'inputs[0]: expected a list, got text \'force\'; it is written ["name", "unit"]'),
        ("outputs", "position", 'outputs: expected a list, got text \'position\'; it is written [["name", "unit"], ...]'),
        ("C", 3, "C: expected a list, got 3; it is written [[number, ...], ...]"),
        ("initial_state", 3, "initial_state: expected a list, got 3; it is written [number, ...]"),
    ],
)
def test_for_an_array_of_another_form_the_message_says_how_it_is_written(key: str, value: object, fault: str) -> None:
    plant = {"kind": "state-space", "A": [[0, 1], [0, -1]], "B": [[0], [1]], "C": [[1, 0]], key: value}
    with pytest.raises(hil.HilError) as why:
        hil.load_experiment("dc-motor-hinf", plant=plant)
    assert f"plant.{fault}" in str(why.value)
