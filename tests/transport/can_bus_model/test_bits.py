"""Exact lengths of frames: published values, a receiver that reads them back, and can-utils for classic ones."""

from __future__ import annotations

import os
import random
import shutil
import subprocess
from pathlib import Path

import pytest

from tests.transport.can_bus_model.receiver import LENGTHS, read
from transport.can_bus_model import CanFrame, arbitration_key
from transport.can_bus_model.bits import frame_bounds, frame_length, wire_bits
from transport.errors import FieldError

CAN_UTILS = Path(os.environ.get("CAN_UTILS", "can-utils"))  # its source, GPL or BSD: a peer to test against, not a part of this


def random_frame(rng: random.Random, *, fd: bool | None = None) -> CanFrame:
    fd = rng.random() < 0.5 if fd is None else fd
    extended, remote = rng.random() < 0.5, not fd and rng.random() < 0.1
    size = rng.choice(LENGTHS) if fd else rng.randrange(9)
    weights = rng.choice(((0, 255), (0, 1, 0xF0, 0x0F, 0x3C, 0x78, 255), range(256)))  # long runs of equal bits among them
    return CanFrame(
        identifier=rng.choice((0, rng.getrandbits(29 if extended else 11), 0x1FFFFFFF if extended else 0x7FF)),
        data=b"" if remote else bytes(rng.choice(weights) for _ in range(size)),
        extended=extended, remote=remote, dlc=rng.randrange(9) if remote else None, fd=fd,
        bitrate_switch=fd and rng.random() < 0.7, error_state=fd and rng.random() < 0.3,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("identifier", "data", "bits"),
    [
        (0x123, "1122334455667788", 112), (0x0, "", 53), (0x7FF, "", 50), (0x555, "", 48), (0x7FF, "FF" * 8, 126),
        (0x0, "00" * 8, 127), (0x555, "55" * 8, 112), (0x78, "3C" * 8, 131), (0x100, "00CA22FF5566AADF", 117),
    ],
)  # fmt: skip
def test_published_lengths_of_base_frames(identifier: int, data: str, bits: int) -> None:
    assert frame_length(CanFrame(identifier=identifier, data=bytes.fromhex(data))) == (bits, 0)


def test_published_lengths_of_extended_and_remote_frames() -> None:
    def bits(identifier: int, data: str) -> int:
        return sum(frame_length(CanFrame(identifier=identifier, data=bytes.fromhex(data), extended=True)))

    assert bits(0x12345678, "0001020304050607") == 143
    assert (bits(0x1FFFFFFF, "FF" * 8), bits(0, "00" * 8)) == (149, 150)
    assert frame_length(CanFrame(identifier=0x123, remote=True)) == (48, 0)
    assert frame_length(CanFrame(identifier=0x12345678, extended=True, remote=True)) == (69, 0)


@pytest.mark.parametrize(
    ("identifier", "size", "byte", "bits"),
    [
        (0x123, 0, 0x55, (29, 33)), (0x123, 1, 0x55, (29, 41)), (0x123, 8, 0x55, (29, 97)), (0x123, 12, 0x55, (29, 129)),
        (0x123, 16, 0x55, (29, 161)), (0x123, 20, 0x55, (29, 198)), (0x123, 32, 0x55, (29, 294)), (0x123, 64, 0x55, (29, 550)),
        (0x0, 8, 0, (31, 110)), (0x0, 64, 0, (31, 652)), (0x18DAF110, 8, 0xFF, (49, 109)), (0x18DAF110, 64, 0xFF, (49, 653)),
    ],
)  # fmt: skip
def test_lengths_of_fd_frames_with_bit_rate_switch(identifier: int, size: int, byte: int, bits: tuple[int, int]) -> None:
    frame = CanFrame(identifier=identifier, data=bytes([byte] * size), extended=identifier > 0x7FF, fd=True, bitrate_switch=True)
    assert frame_length(frame) == bits


def test_a_receiver_reads_every_frame_back_bit_by_bit_and_counts_the_same_bits() -> None:
    rng = random.Random(28)
    for _ in range(4000):
        frame = random_frame(rng)
        wire = wire_bits(frame)
        assert read(wire.bits) == (frame, tuple(wire.length))


def test_a_fixed_stuff_bit_takes_the_place_of_a_dynamic_one_that_is_due_behind_the_data() -> None:
    five, four = (CanFrame(identifier=0x123, data=data, fd=True) for data in (b"\x1f", b"\x0f"))  # equal bits at the end
    assert frame_length(five) == frame_length(four)


def test_no_frame_is_longer_than_the_bound_and_the_bound_of_classic_frames_is_reached_but_for_their_crc() -> None:
    rng = random.Random(7)
    for _ in range(3000):
        frame = random_frame(rng)
        size = 0 if frame.remote else len(frame.data)
        _, most = frame_bounds(size, extended=frame.extended, fd=frame.fd, bitrate_switch=frame.bitrate_switch)
        length = frame_length(frame)
        assert length.nominal <= most.nominal and length.data <= most.data
    for size in range(9):
        assert [sum(frame_bounds(size, extended=e)[1]) for e in (False, True)] == [55 + 10 * size, 80 + 10 * size]
    assert sum(frame_bounds(64, fd=True)[1]) == 712 and sum(frame_bounds(64, fd=True, extended=True)[1]) == 736


def test_the_lower_bits_win_as_on_the_wire() -> None:
    rng = random.Random(5)
    for _ in range(500):
        first, second = random_frame(rng, fd=False), random_frame(rng, fd=False)
        plain = [f"{arbitration_key(frame):032b}" for frame in (first, second)]
        on_the_wire = [wire_bits(frame).bits for frame in (first, second)]
        if plain[0] != plain[1]:
            assert (plain[0] < plain[1]) == (on_the_wire[0] < on_the_wire[1])


@pytest.mark.parametrize(
    ("field", "frame"),
    [
        ("identifier", {"identifier": 0x800}), ("identifier", {"identifier": 1 << 29, "extended": True}),
        ("data", {"identifier": 1, "data": bytes(9)}), ("data", {"identifier": 1, "data": bytes(9), "fd": True}),
        ("remote", {"identifier": 1, "remote": True, "fd": True}), ("dlc", {"identifier": 1, "dlc": 3}),
        ("bitrate_switch", {"identifier": 1, "bitrate_switch": True}),
    ],
)  # fmt: skip
def test_what_is_no_frame_is_refused_with_its_field(field: str, frame: dict[str, object]) -> None:
    with pytest.raises(FieldError) as caught:
        CanFrame(**frame)  # type: ignore[arg-type]
    assert caught.value.field == field


MAIN = r"""
#include <stdio.h>
#include <string.h>
#include <linux/can.h>
#include "canframelen.h"
int main(void) {
    unsigned id, length, i, byte;
    while (scanf("%x %u", &id, &length) == 2) {
        struct canfd_frame frame;
        memset(&frame, 0, sizeof frame);
        frame.can_id = id; frame.len = length;
        for (i = 0; i < length; i++) { if (scanf("%x", &byte) != 1) return 1; frame.data[i] = byte; }
        printf("%u\n", can_frame_length(&frame, CFL_EXACT, CAN_MTU));
    }
    return 0;
}
"""


@pytest.mark.skipif(
    not (CAN_UTILS / "canframelen.c").exists() or shutil.which("cc") is None,
    reason="no C compiler, or no source of can-utils: git clone https://github.com/linux-can/can-utils and set CAN_UTILS to it",
)
def test_classic_lengths_are_those_of_can_utils_on_a_hundred_thousand_random_frames(tmp_path: Path) -> None:
    (tmp_path / "main.c").write_text(MAIN)
    sources = [tmp_path / "main.c", CAN_UTILS / "canframelen.c"]
    subprocess.run(["cc", "-O1", "-I", CAN_UTILS, *sources, "-o", tmp_path / "exact"], check=True)
    rng = random.Random(100)
    frames = [random_frame(rng, fd=False) for _ in range(100_000)]
    frames = [f for f in frames if not f.remote or not f.dlc]  # can-utils counts the data that a remote frame does not have
    lines = [f"{f.identifier | f.extended << 31 | f.remote << 30:x} {len(f.data)} {f.data.hex(' ')}" for f in frames]
    both = subprocess.run([tmp_path / "exact"], input="\n".join(lines), capture_output=True, text=True, check=True).stdout.split()
    ours = [wire_bits.__wrapped__(frame).length for frame in frames]
    assert len(frames) > 90_000 and [int(bits) for bits in both] == [length.nominal for length in ours]
