"""A run of random faults: each is put in, tests are asked, and a table says by room how many were seen."""

from __future__ import annotations

import math
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Final, Literal, get_args

from tests.mutations.judge import Judge, UndecidedError, asked_for, at_once, own_tests
from tests.mutations.random_faults import Place, drawn, equivalent
from tests.mutations.reach import kept, product_files

WANTED: Final = 0.85
BY_OWN: Final = 0.5
"""Share that tests see, and that a file's own tests see without those of other rooms (they saw 64 % of 45 over all rooms)."""
CHANCE: Final = 0.001
"""With which a run fails where each room's tests see the wanted share of its faults."""

Outcome = Literal["killed", "survived", "undecided", "equivalent"]
"""A test failed; all passed; time was spent before, or the fault was not begun; it stands in ``equivalent.toml``."""
Tried = tuple[Place, Outcome]


def random_run(
    number: int, seed: int, words: Sequence[str], *, own: Sequence[str] | None, limit_s: float, fresh: bool, workers: int,
    decide: bool = False,
) -> int:  # fmt: skip
    """Try random faults and print one line each, then the table; Ctrl-C ends with the table so far.

    Args:
        number: of faults, over all rooms.
        seed: of the draw.
        words: only the drawn faults whose line contains one of them.
        own: files to draw in, of which their own tests are asked; None: all files, and the tests that reach each block.
        limit_s: after which tests are ended, s.
        fresh: measure again what each test reaches.
        workers: processes that try faults, or measure what tests reach.
        decide: begin no fault where so many were seen that the run cannot fail any more.

    Returns:
        1 if so many survived that the wanted share is not to be believed, else 0.
    """
    end = time.monotonic() + limit_s
    chosen = drawn(product_files() if own is None else own, number, seed)[:number]
    places = [place for place in chosen if not words or any(word in str(place) for word in words)]
    doubtful: set[str] = set()
    tests_of: Callable[[Place], Sequence[str]] = own_tests
    if own is None:
        reach = kept(workers, fresh)
        doubtful = {test for test, realtime in zip(reach.tests, reach.realtime) if realtime}
        tests_of = partial(asked_for, reach=reach)
    known, wanted = equivalent(), WANTED if own is None else BY_OWN
    done: list[Tried] = [(place, "equivalent") for place in places if place.key in known]
    tried = [place for place in places if place.key not in known]
    enough = len(tried) - limit(len(tried), wanted) if decide else math.inf
    done += _tried(tried, tests_of, doubtful, end, max(workers, 1), enough)
    print("\n".join([*table(done), *rule(done, wanted)]))
    return int(too_few(done, wanted))


def _tried(
    places: Sequence[Place], tests_of: Callable[[Place], Sequence[str]], doubtful: set[str], end: float, workers: int,
    enough: float,
) -> list[Tried]:  # fmt: skip
    def outcome(judge: Judge, place: Place) -> tuple[Outcome, str, float]:
        begin = time.monotonic()
        try:
            if begin > end or len(seen) >= enough:
                raise UndecidedError("not begun")
            tests = tests_of(place)
            killer = judge.killer(place, tests, end)
            seconds = time.monotonic() - begin
            seen.extend([place] * (killer is not None))
            return ("killed", f"by {killer}", seconds) if killer else ("survived", f"{len(tests)} asked", seconds)
        except UndecidedError as error:
            return "undecided", str(error), time.monotonic() - begin

    seen: list[Place] = []
    done: dict[Place, Outcome] = dict.fromkeys(places, "undecided")
    try:
        for n, (place, (done[place], how, seconds)) in enumerate(at_once(places, outcome, workers, doubtful), start=1):
            print(f"{n}/{len(places)} {done[place]:9} {seconds:5.1f} s  {place}\n{'':12}{how}", flush=True)
    except KeyboardInterrupt:
        print("stopped")
    return [*done.items()]


def limit(number: int, wanted: float = WANTED) -> int:
    """Return how many of so many faults may survive: more do in less than `CHANCE` of all draws where the wanted share is seen.

    Where it is seen in each room, also if some are seen better than others and each is drawn once, at most as often
    (W. Hoeffding, On the distribution of the number of successes in independent trials, 1956).

    >>> limit(0), limit(12), limit(30), limit(300), limit(20, BY_OWN)
    (0, 6, 11, 65, 17)
    """
    return next(k for k in range(number + 1) if more_than(k, number, 1.0 - wanted) < CHANCE)


def more_than(k: int, number: int, share: float) -> float:
    """Return the chance that more than k of so many faults survive where a share does.

    >>> round(more_than(11, 30, 0.15), 5), round(more_than(11, 30, 0.5), 2)
    (0.00079, 0.9)
    """
    return sum(math.comb(number, n) * share**n * (1.0 - share) ** (number - n) for n in range(k + 1, number + 1))


def too_few(done: Sequence[Tried], wanted: float = WANTED) -> bool:
    """Return whether too many survived for the wanted share to be believed; what is undecided counts as seen."""
    count = Counter(outcome for _, outcome in done)
    return count["survived"] > limit(len(done) - count["equivalent"], wanted)


def rule(done: Sequence[Tried], wanted: float = WANTED) -> list[str]:
    """Return what a run says beside its table: when it fails, how often by chance, and how often where few are seen."""
    number = sum(outcome != "equivalent" for _, outcome in done)
    k, few = limit(number, wanted), 0.5 if wanted > 0.5 else 0.1
    return [
        f"fails where more than {k} of {number} survive:",
        f"in {more_than(k, number, 1.0 - wanted):.2%} of draws where the asked tests see {wanted:.0%} of each room's faults,",
        f"in {more_than(k, number, 1.0 - few):.0%} where they see {few:.0%} of them and none is undecided",
    ]


def table(done: Iterable[Tried]) -> list[str]:
    """Return the lines of a table: what became of faults by room, and in all.

    The share that is seen is of all but the equivalent ones; where some are undecided it lies between two numbers.
    """
    by_room: dict[str, Counter[str]] = defaultdict(Counter)
    for place, outcome in done:
        for room in (place.room, "all"):
            by_room[room][outcome] += 1
    lines = [f"{'room':24}{'faults':>8}" + "".join(f"{outcome:>12}" for outcome in get_args(Outcome)) + f"{'share':>14}"]
    for room, count in sorted(by_room.items(), key=lambda each: (each[0] == "all", each[0])):
        judged = count.total() - count["equivalent"]
        ends = (count["killed"], judged - count["survived"])  # where all that is undecided is alive, or seen
        share = " to ".join(dict.fromkeys(f"{seen / judged:.0%}" for seen in ends)) if judged else "-"
        lines.append(f"{room:24}{count.total():8}" + "".join(f"{count[each]:12}" for each in get_args(Outcome)) + f"{share:>14}")
    return lines
