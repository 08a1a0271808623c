"""MATLAB's files: read as scipy writes them, refused where they are damaged."""

from __future__ import annotations

import io
import struct
from typing import Any

import numpy as np
import pytest
from scipy.io import savemat

from hil.errors import HilError
from hil.experiment.mat_file import variables

MOST = 1 << 20
NUMBERS: dict[str, Any] = {
    "double": np.array([[1.0, np.nan, -0.05], [0.0, 2.0, 1e300]]), "single": np.float32([[1.5], [2.5]]),
    "flag": np.array([[True, False]]),
    "cube": np.arange(24.0).reshape(2, 3, 4), "empty": np.empty((0, 3)), "one": np.array([[7.0]]), "row": np.arange(3),
} | {kind: np.array([[1, 2], [3, 100]], dtype=kind) for kind in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8")}  # fmt: skip
OTHERS = {"c": np.array([[1j]]), "words": "abc", "cells": np.array([1, "a"], dtype=object), "fields": {"x": 1.0}}


def saved(contents: dict[str, Any], **how: Any) -> bytes:
    out = io.BytesIO()
    savemat(out, contents, **how)
    return out.getvalue()


@pytest.mark.parametrize("packed", [False, True])
def test_every_kind_of_number_is_read_as_it_was_written(packed: bool) -> None:
    found = {each.name: each for each in variables(saved(NUMBERS | OTHERS, do_compression=packed), MOST)}
    assert found.keys() == NUMBERS.keys() | OTHERS.keys()
    for name, expected in NUMBERS.items():
        array = found[name].array()
        np.testing.assert_array_equal(array, np.atleast_2d(expected), err_msg=name)
        assert array.dtype == expected.dtype, name
    assert {name: found[name].kind for name in OTHERS} == {"c": "complex", "words": "char", "cells": "cell", "fields": "struct"}


def test_version_4_is_read_in_both_byte_orders() -> None:
    old = {"A": NUMBERS["double"], "n": np.int32([[1, 2]]), "s": "abc", "c": np.array([[1j]]), "last": np.array([[3.0]])}
    found = {each.name: each for each in variables(saved(old, format="4"), MOST)}
    assert {name: each.kind for name, each in found.items()} == {
        "A": "numbers", "n": "numbers", "s": "char", "c": "complex", "last": "numbers",
    }  # fmt: skip
    for name in ("A", "n", "last"):
        np.testing.assert_array_equal(found[name].array(), old[name])
    (big,) = variables(struct.pack(">5i", 1000, 1, 2, 0, 2) + b"A\0" + struct.pack(">2d", 0.5, 4.0), MOST)
    np.testing.assert_array_equal(big.array(), [[0.5, 4.0]])


@pytest.mark.parametrize("cut", [1, 20, 127, 130, 150, 170, 190, -1])
def test_what_is_cut_is_refused_or_has_fewer_variables(cut: int) -> None:
    whole = saved({"A": NUMBERS["double"]})
    try:
        assert not list(variables(whole[:cut], MOST))
    except (ValueError, struct.error):
        pass


def test_what_unpacks_to_too_much_is_refused() -> None:
    with pytest.raises(HilError, match="unpacks to more than 5000 bytes"):
        list(variables(saved({"A": np.zeros((100, 10))}, do_compression=True), 5000))
