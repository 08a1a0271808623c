"""A log goes over a link as its run did."""

from __future__ import annotations

import re

import pytest

from hil.compose.loop import compose
from hil.errors import HilError
from hil.experiment import load_experiment
from hil.runtime.virtual import simulate_as_logged
from hil.session.replay.over_link import ask_process


def test_the_questions_of_several_nodes_go_over_a_link_that_knows_them() -> None:
    run = simulate_as_logged(compose(load_experiment("multisensor-published", ["duration=1"])), 0)
    with pytest.raises(HilError, match=re.escape("no controller answered on can:hil:nodesreplay?nodes=4 within")):
        ask_process(run, "can:hil:nodesreplay", start_s=0.05)
