"""What happens between two instants: in order, and not without end."""

from __future__ import annotations

import pytest

from plants.errors import PlantError
from plants.parts import flow


class Ticking:
    """Fires every so many nanoseconds."""

    def __init__(self, step_ns: int) -> None:
        self.next_ns, self._step_ns, self.fired = step_ns, step_ns, 0

    def fire(self) -> None:
        self.next_ns += self._step_ns
        self.fired += 1


@pytest.mark.parametrize(("end_ns", "fires"), [(flow.MOST_EVENTS - 1, flow.MOST_EVENTS - 1), (flow.MOST_EVENTS, None)])
def test_what_changes_without_end_is_refused_and_not_waited_for(end_ns: int, fires: int | None) -> None:
    source, pieces = Ticking(1), list[tuple[int, int]]()
    if fires is None:
        with pytest.raises(PlantError, match=r"Ticking: more than 100000 changes in 0\.0001 s, too many to be run"):
            flow.pass_time(0, end_ns, [source], lambda *ends: pieces.append(ends))
    else:
        flow.pass_time(0, end_ns, [source], lambda *ends: pieces.append(ends))
        assert source.fired == fires and pieces[-1][1] == end_ns
