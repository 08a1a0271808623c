"""What happens between two instants: in order, and not without end."""

from __future__ import annotations

import pytest

from plants.errors import PlantError
from plants.parts import events


class Ticking:
    """Fires every so many nanoseconds."""

    def __init__(self, step_ns: int) -> None:
        self.next_ns, self._step_ns, self.fired = step_ns, step_ns, 0

    def fire(self) -> None:
        self.next_ns += self._step_ns
        self.fired += 1


@pytest.mark.parametrize(("step_ns", "fires"), [(100, 9), (101, 9), (91, None), (1, None)])
def test_what_changes_without_end_is_refused_and_not_waited_for(
    step_ns: int, fires: int | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(events, "MOST_EVENTS", 10)
    source, pieces = Ticking(step_ns), list[tuple[int, int]]()
    if fires is None:
        with pytest.raises(PlantError, match=r"Ticking: more than 10 changes in 9\.99e-07 s, too many to be run"):
            events.pass_time(0, 999, [source], lambda *ends: pieces.append(ends))
    else:
        events.pass_time(0, 999, [source], lambda *ends: pieces.append(ends))
        assert source.fired == fires and pieces[-1][1] == 999
