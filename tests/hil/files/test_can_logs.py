"""What a BLF file may unpack to, and where its last whole object ends; tests of recordings and exports read whole files."""

from __future__ import annotations

import zlib

import pytest

from hil.files.can_logs import _OBJECT, _PACKING, LARGEST, _unpacked, _whole_objects

WHOLE = _OBJECT.pack(b"LOBJ", 16, 1, _OBJECT.size + 8, 1) + bytes(8)


def test_a_container_is_plain_or_packed_and_unpacks_to_so_much_at_most() -> None:
    assert _unpacked(_PACKING.pack(0, 3) + b"abc") == b"abc"
    assert _unpacked(_PACKING.pack(2, 3) + zlib.compress(b"abc")) == b"abc"
    with pytest.raises(ValueError, match="packed by method 7, expected 0 or 2"):
        _unpacked(_PACKING.pack(7, 3) + b"abc")
    largest = _PACKING.pack(2, LARGEST) + zlib.compress(bytes(LARGEST))
    assert len(_unpacked(largest)) == LARGEST
    with pytest.raises(ValueError, match=f"unpacks to more than {LARGEST} bytes"):
        _unpacked(_PACKING.pack(2, LARGEST) + zlib.compress(bytes(LARGEST + 1)))


@pytest.mark.parametrize("behind", [b"", WHOLE, b"\0" + WHOLE, WHOLE[:5], WHOLE[:-1], b"\0\0\0"])
def test_what_is_not_whole_waits_for_the_next_container(behind: bytes) -> None:
    data = WHOLE + behind
    assert _whole_objects(data) == (len(data) if data.endswith(WHOLE) else len(WHOLE))


@pytest.mark.parametrize(
    ("behind", "said"),
    [(b"x" * 9, "no object begins where the one before ends"), (_OBJECT.pack(b"LOBJ", 16, 1, 3, 1), "an object of 3 bytes"),
     (_OBJECT.pack(b"LOBJ", 16, 1, LARGEST + 1, 1), f"an object of {LARGEST + 1} bytes, expected {_OBJECT.size} to {LARGEST}")],
)  # fmt: skip
def test_what_is_no_object_is_refused(behind: bytes, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        _whole_objects(WHOLE + behind)
