"""A run of random faults: each is put in, tests are asked, and a table says by room how many were seen."""

from __future__ import annotations

import math
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from tests import changed as differences
from tests.mutations.copies import copy_of_the_checkout
from tests.mutations.judge import Judge, asked_for, own_tests
from tests.mutations.random_faults import Place, drawn
from tests.mutations.reach import kept, product_files

WANTED = 0.85
CHANCE = 0.05
"""With which a share that is wanted or more still looks too small."""

Tried = tuple[Place, str | None]
"""A fault, and the test that saw it."""


def random_run(
    number: int, seed: int, words: Sequence[str], *, since: str | None, limit_s: float, fresh: bool, workers: int
) -> int:  # fmt: skip
    """Try random faults and print one line each, then the table; Ctrl-C ends with the table so far.

    Args:
        number: of faults, over all rooms.
        seed: of the draw.
        words: only the drawn faults whose line contains one of them.
        since: draw in the files that differ from this revision, and ask the tests of each file alone.
        limit_s: after which no other fault is begun, s.
        fresh: measure again what each test reaches.
        workers: processes that measure it.

    Returns:
        1 if so few were seen that the wanted share is not to be believed, else 0.
    """
    changed = None if since is None else {*differences.changed(since=since)}
    files = [file for file in product_files() if changed is None or file in changed]
    places = [place for place in drawn(files, number, seed)[:number] if not words or any(word in str(place) for word in words)]
    if not places:
        print(f"no faults to try: no product file differs from {since}" if since else "no fault is drawn that is called so")
        return 0
    if since is None:
        reach = kept(workers, fresh)
        doubtful = {test for test, realtime in zip(reach.tests, reach.realtime) if realtime}
        done = _tried(places, lambda place: [*asked_for(place, reach)], doubtful, limit_s)
    else:
        done = _tried(places, own_tests, set(), limit_s)
    print("\n".join(table(done)))
    return int(too_few(len(done), sum(killer is not None for _, killer in done)))


def _tried(places: Sequence[Place], tests_of: Callable[[Place], list[str]], doubtful: set[str], limit_s: float) -> list[Tried]:
    done: list[Tried] = []
    end = time.monotonic() + limit_s
    try:
        with tempfile.TemporaryDirectory() as name, Judge(copy_of_the_checkout(Path(name, "checkout")), doubtful) as judge:
            for n, place in enumerate(places, start=1):
                if time.monotonic() > end:
                    print(f"no more after {limit_s:g} s")
                    break
                tests = tests_of(place)
                killer = judge.killer(place, tests)
                done.append((place, killer))
                how = f"killed   {place}\n{'':12}by {killer}" if killer else f"SURVIVED {place}\n{'':12}{len(tests)} tests asked"
                print(f"{n}/{len(places)} {how}", flush=True)
    except KeyboardInterrupt:
        print("stopped")
    return done


def too_few(tried: int, seen: int) -> bool:
    """Return whether so few are seen in less than `CHANCE` of all draws, where the wanted share is seen.

    >>> too_few(12, 8), too_few(12, 7), too_few(300, 245), too_few(300, 244), too_few(0, 0)
    (False, True, False, True, False)
    """
    chances = (math.comb(tried, k) * WANTED**k * (1.0 - WANTED) ** (tried - k) for k in range(seen + 1))
    return sum(chances) < CHANCE


def table(done: Iterable[Tried]) -> list[str]:
    """Return the lines of a table: faults seen by room, and in all."""
    by_room: dict[str, list[bool]] = defaultdict(list)
    for place, killer in done:
        for room in (place.room, "all"):
            by_room[room].append(killer is not None)
    rows = [(room, len(seen), sum(seen)) for room, seen in sorted(by_room.items(), key=lambda each: (each[0] == "all", each[0]))]
    return [f"{'room':24}{'faults':>8}{'seen':>6}{'share':>8}", *(f"{r:24}{n:8}{k:6}{k / n:8.0%}" for r, n, k in rows)]
