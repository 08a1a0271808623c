"""A run of random faults: each is put in, tests are asked, and a table says by room how many were seen."""

from __future__ import annotations

import tempfile
from collections import defaultdict
from collections.abc import Iterable, Sequence
from pathlib import Path

from tests import changed as differences
from tests.mutations.copies import copy_of_the_checkout
from tests.mutations.judge import Judge, asked_for
from tests.mutations.random_faults import Place, drawn
from tests.mutations.reach import kept, measure, product_files

WANTED = 0.85


def random_run(number: int, seed: int, words: Sequence[str], *, changed: bool, fresh: bool, workers: int) -> int:
    """Try random faults and print one line each, then the table; Ctrl-C ends with the table so far.

    Args:
        number: of faults, over all rooms.
        seed: of the draw.
        words: only the drawn faults whose line contains one of them.
        changed: draw in the files that differ from main, and ask the tests of those alone.
        fresh: measure again what each test reaches.
        workers: processes that measure it.

    Returns:
        1 if less than the wanted share was seen, else 0.
    """
    files = [file for file in product_files() if not changed or file in differences.changed()]
    places = [place for place in drawn(files, number, seed) if not words or any(word in str(place) for word in words)]
    if not places:
        print("no faults to try: no product file differs from main" if changed else "no fault is drawn that is called so")
        return 0
    reach = measure(differences.chosen_for(files), workers) if changed else kept(workers, fresh)
    doubtful = {test for test, realtime in zip(reach.tests, reach.realtime) if realtime}
    done: list[tuple[Place, str | None]] = []
    try:
        with tempfile.TemporaryDirectory() as name:
            judge = Judge(copy_of_the_checkout(Path(name, "checkout")), doubtful)
            for n, place in enumerate(places, start=1):
                tests = asked_for(place, reach)
                killer = judge.killer(place, tests)
                done.append((place, killer))
                how = f"killed   {place}\n{'':12}by {killer}" if killer else f"SURVIVED {place}\n{'':12}{len(tests)} tests asked"
                print(f"{n}/{len(places)} {how}", flush=True)
    except KeyboardInterrupt:
        print("stopped")
    print("\n".join(table(done)))
    return int(sum(killer is not None for _, killer in done) < WANTED * len(done))


def table(done: Iterable[tuple[Place, str | None]]) -> list[str]:
    """Return the lines of a table: faults seen by room, and in all."""
    by_room: dict[str, list[bool]] = defaultdict(list)
    for place, killer in done:
        for room in (place.room, "all"):
            by_room[room].append(killer is not None)
    rows = [(room, len(seen), sum(seen)) for room, seen in sorted(by_room.items(), key=lambda each: (each[0] == "all", each[0]))]
    return [f"{'room':24}{'faults':>8}{'seen':>6}{'share':>8}", *(f"{r:24}{n:8}{k:6}{k / n:8.0%}" for r, n, k in rows)]
