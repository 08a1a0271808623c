"""A receiver that takes a frame bit by bit, as a controller does: what the model sends is read back by other means."""

from __future__ import annotations

from collections.abc import Iterator

from transport.can_bus_model import CanFrame

LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
GRAY = ("000", "001", "011", "010", "110", "111", "101", "100")


class Receiver:
    """Reads bits one after the other; the dynamic stuff bits are dropped and counted."""

    def __init__(self, bits: str) -> None:
        self._bits: Iterator[str] = iter(bits)
        self.raw = ""  # on the wire
        self.plain = ""  # without dynamic stuff bits
        self.dropped = 0

    def wire(self, count: int = 1) -> str:
        got = "".join(next(self._bits) for _ in range(count))
        self.raw += got
        return got

    def take(self, count: int = 1) -> str:
        for _ in range(count):
            if len(self.raw) >= 5 and len(set(self.raw[-5:])) == 1:
                stuff = self.wire()
                assert stuff != self.raw[-2], "six equal bits: a stuff error"
                self.dropped += 1
            self.plain += self.wire()
        return self.plain[len(self.plain) - count :] if count else ""


def remainder(bits: str, generator: int, width: int, start: int) -> int:
    """Long division of polynomials over GF(2), the register's start folded into the first bits."""
    value = int(bits + "0" * width, 2) ^ start << len(bits)
    for shift in range(len(bits) + width - 1, width - 1, -1):
        if value >> shift & 1:
            value ^= generator << shift - width
    return value


def read(bits: str) -> tuple[CanFrame, tuple[int, int]]:
    """Return the frame that the bits carry, and (nominal, data) bits as the receiver counts them."""
    r = Receiver(bits)
    assert r.take() == "0"
    identifier = int(r.take(11), 2)
    third, ide = r.take(), r.take()
    extended = ide == "1"
    if extended:
        assert third == "1"
        identifier = identifier << 18 | int(r.take(18), 2)
        third = r.take()
    fd = r.take() == "1"
    switch = state = False
    fast_from = 0
    if fd:
        assert third == "0" and r.take() == "0"
        switch = r.take() == "1"
        fast_from = len(r.raw)
        state = r.take() == "1"
    elif extended:
        assert r.take() == "0"
    code = int(r.take(4), 2)
    remote = not fd and third == "1"
    size = 0 if remote else LENGTHS[code] if fd else min(code, 8)
    data = bytes(int(r.take(8), 2) for _ in range(size))
    if fd:
        covered, dropped, field = r.raw, r.dropped, ""
        width, generator = (17, 0x3685B) if size <= 16 else (21, 0x302899)
        for _ in range((4 + width + 3) // 4):
            fixed = r.wire()
            assert fixed != r.raw[-2], "a fixed stuff bit is the complement of the bit before it"
            field += r.wire(min(4, 4 + width - len(field)))
        assert field[:3] == GRAY[dropped % 8] and field[:4].count("1") % 2 == 0
        assert int(field[4:], 2) == remainder(covered + field[:4], generator, width, 1 << width - 1)
    else:
        covered = r.plain
        assert int(r.take(15), 2) == remainder(covered, 0xC599, 15, 0)
        if len(set(r.raw[-5:])) == 1:
            assert r.wire() != r.raw[-2]
    assert r.wire() == "1"
    fast = len(r.raw) - fast_from if switch else 0
    assert r.wire(12) == "0" + "1" * 11 and next(r._bits, None) is None
    frame = CanFrame(
        identifier=identifier, data=data, extended=extended, remote=remote, dlc=code if remote else None, fd=fd,
        bitrate_switch=switch, error_state=state,
    )  # fmt: skip
    return frame, (len(r.raw) - fast, fast)
