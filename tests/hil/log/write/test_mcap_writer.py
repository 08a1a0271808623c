"""What compresses chunks: the frames of zstd, and memory that no burst changes."""

import numpy as np
import zstandard

from hil.log.write.mcap_writer import Compressor

ROOM = 1 << 15


def data(length: int) -> bytes:
    return np.random.default_rng(length).integers(0, 9, length, np.uint8).tobytes()


def memory(compressor: Compressor) -> int:
    return sum(context.memory_size() for context in compressor.contexts.values())


def test_memory_is_taken_once_whatever_comes() -> None:
    """A session grew by 0.9 MB where it was kept from its pipe for 0.1 s: the chunk after that was long."""
    ours, plain = Compressor(ROOM), zstandard.ZstdCompressor()
    taken, one = {memory(ours)}, set()
    lengths = np.random.default_rng(0).integers(1, ROOM, 400).tolist()
    for length in (*[ROOM // 40] * 300, ROOM, *lengths, 1, ROOM):
        ours.compress(data(length))
        plain.compress(data(length))
        taken.add(memory(ours))
        one.add(plain.memory_size())
    assert len(taken) == 1 < len(one)


def test_a_frame_is_what_one_context_makes_of_it() -> None:
    ours, plain = Compressor(ROOM), zstandard.ZstdCompressor()
    for length in (0, 1, 700, 1024, 1025, ROOM, 12, 5 * ROOM):
        assert ours.compress(data(length)) == plain.compress(data(length))
