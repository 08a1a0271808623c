"""Real bytes with a few places damaged: cheap enough for a million inputs, the same for the same seed."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from random import Random

NUMBERS = [
    b"0", b"-1", b"-0.0", b"nan", b"inf", b"-inf", b"1e400", b"1e308", b"1e-400",
    b"5e-324", b"9" * 400, b"9" * 4400, b"18446744073709551616",
    b"-9223372036854775809", b"2147483648", b"1_000", b"0x10", b"1e", b".", b"", b"true", b"null", b'"1"', b"[1]", b"[]", b"{}",
]  # fmt: skip
TEXT = [
    *(bytes([c]) for c in b"=[]{}\"'\n\r\t.,:;#\\/&?@ \0\x1b\x7f\x80\xff"), b'"""',
    b"\x1b[2J", b"a." * 40, b"[" * 40, b"[" * 4000, b"\xc3\xa9",
    b"\xef\xbb\xbf", b"\xe2\x80\xae", b"../..", b"/dev/zero", b"$HOME", b"%s%n", b"nan s",
    b"1e400 s", b"10 ms", b"null", b"x" * 300,
]  # fmt: skip
WORDS = [n.to_bytes(size, "little") for size in (1, 2, 4, 8) for n in (0, 1, 1 << (8 * size - 1), (1 << (8 * size)) - 1)]
WORDS += [n.to_bytes(8, "little") for n in (64 << 20, 1 << 31, 1 << 32, 1 << 62)]
NUMBER = re.compile(rb"-?\d+(?:\.\d*)?(?:e[-+]?\d+)?")

Edit = Callable[[Random, bytearray], None]


def _span(rng: Random, data: bytearray, most: int = 12) -> tuple[int, int]:
    at = rng.randrange(len(data) + 1)
    return at, at + rng.randrange(1, most)


def flip(rng: Random, data: bytearray) -> None:
    """Turn one bit over."""
    if data:
        data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)


def scribble(rng: Random, data: bytearray) -> None:
    """Put random bytes over others."""
    at, end = _span(rng, data)
    data[at:end] = rng.randbytes(end - at)


def cut(rng: Random, data: bytearray) -> None:
    """Take a piece out, rarely all that follows."""
    at, end = _span(rng, data, 40)
    del data[at : end if rng.random() < 0.8 else None]


def double(rng: Random, data: bytearray) -> None:
    """Repeat a piece, rarely many times."""
    at, end = _span(rng, data, 60)
    data[at:at] = data[at:end] * (1 if rng.random() < 0.9 else 50)


def insert(pieces: Sequence[bytes]) -> Edit:
    """Put one of these in, in the place of as many bytes or between them."""

    def put(rng: Random, data: bytearray) -> None:
        at, end = _span(rng, data)
        piece = rng.choice(pieces)
        data[at : at + len(piece) if rng.random() < 0.5 and len(piece) < 9 else rng.choice((at, end))] = piece

    return put


def renumber(rng: Random, data: bytearray) -> None:
    """Put another number in the place of one."""
    found = NUMBER.search(data, rng.randrange(len(data) + 1))
    if found is not None:
        data[slice(*found.span())] = rng.choice(NUMBERS)


def move_lines(rng: Random, data: bytearray) -> None:
    """Take a line from where it stands to another place, or away."""
    lines = data.split(b"\n")
    line = lines.pop(rng.randrange(len(lines)))
    if rng.random() < 0.7:
        lines.insert(rng.randrange(len(lines) + 1), line)
    data[:] = b"\n".join(lines)


OF_TEXT: tuple[Edit, ...] = (flip, scribble, cut, double, insert(TEXT), renumber, renumber, move_lines)
OF_BYTES: tuple[Edit, ...] = (flip, flip, scribble, cut, double, insert(WORDS), insert(WORDS))


def mutated(rng: Random, data: bytes, kinds: Sequence[Edit], edits: int) -> bytes:
    """Return the bytes with so many edits."""
    out = bytearray(data)
    for _ in range(edits):
        rng.choice(kinds)(rng, out)
    return bytes(out)
