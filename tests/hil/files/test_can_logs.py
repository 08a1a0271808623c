"""What a BLF file may unpack to, and where its last whole object ends; tests of recordings and exports read whole files."""

from __future__ import annotations

import zlib
from pathlib import Path

import pytest

from hil.errors import HilError
from hil.files.can_logs import _OBJECT, _PACKING, LARGEST, _unpacked, _whole_objects, can_frames

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
    assert _whole_objects(bytearray(data)) == (len(data) if data.endswith(WHOLE) else len(WHOLE))


@pytest.mark.parametrize(
    ("behind", "said"),
    [(b"x" * 9, "no object begins where the one before ends"), (_OBJECT.pack(b"LOBJ", 16, 1, 3, 1), "an object of 3 bytes"),
     (_OBJECT.pack(b"LOBJ", 16, 1, LARGEST + 1, 1), f"an object of {LARGEST + 1} bytes, expected {_OBJECT.size} to {LARGEST}")],
)  # fmt: skip
def test_what_is_no_object_is_refused(behind: bytes, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        _whole_objects(bytearray(WHOLE + behind))


def test_many_packed_containers_unpack_to_so_much_together(tmp_path: Path) -> None:
    """Objects of a kind that is no frame: nothing else of them would end a command that reads them, for minutes."""
    packed = _PACKING.pack(2, 0) + zlib.compress(_OBJECT.pack(b"LOBJ", 16, 1, 4000, 99).ljust(4000) * 1000)
    container = _OBJECT.pack(b"LOBJ", 16, 1, _OBJECT.size + len(packed), 10) + packed + bytes(len(packed) % 4)
    (tmp_path / "a.blf").write_bytes(b"LOGG".ljust(4, b"\0") + (144).to_bytes(4, "little") + bytes(136) + 5 * container)
    with pytest.raises(HilError, match=r"a\.blf: is no CAN log: it unpacks to more than 40 times its own length"):
        list(can_frames(tmp_path / "a.blf"))


def test_an_object_in_many_pieces_is_gathered_in_one_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A copy for each piece would take 3 ms where 16 MB wait: hours for a file of a few megabytes."""
    packed = _PACKING.pack(2, 0) + zlib.compress(_OBJECT.pack(b"LOBJ", 16, 1, 4000, 99).ljust(3000))
    bodies = [packed, *5 * [_PACKING.pack(0, 0) + b"x"]]
    parts = [_OBJECT.pack(b"LOBJ", 16, 1, _OBJECT.size + len(body), 10) + body + bytes(len(body) % 4) for body in bodies]
    (tmp_path / "a.blf").write_bytes(b"LOGG" + (144).to_bytes(4, "little") + bytes(136) + b"".join(parts))
    gathered: list[bytearray] = []

    def looked_at(data: bytearray) -> int:
        gathered.append(data)
        return _whole_objects(data)

    monkeypatch.setattr("hil.files.can_logs._whole_objects", looked_at)
    assert not list(can_frames(tmp_path / "a.blf"))
    assert len(gathered) == 6 and len(gathered[0]) == 3005 and all(each is gathered[0] for each in gathered)
