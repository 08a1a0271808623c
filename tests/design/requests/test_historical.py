"""Gains over historical data that an experiment asks for cost least over the starts that it names, where packets get lost too."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from design.controllers import LoopModel, SensorNodes, Turns
from design.controllers.sensor_nodes import window_of
from design.errors import FieldError
from design.historical_data import DelayedPlant, close
from design.historical_data.guaranteed_cost import Start, cost
from design.historical_data.sensor_schedule import mask_of, phase_gains, window_mask
from design.requests.historical import HistoricalDesigned
from design.requests.tracking import DesignTask

A, X0 = np.array([[0.9, 0.3], [-0.2, 0.8]]), np.array([1.0, -2.0])
PLANT = DelayedPlant(A=A, delayed=np.zeros((0, 2, 2)), B=np.array([[0.3], [1.0]]), weight=np.eye(2))
UNIFORM = [0.5, 0.5]
CYCLE, LOSSY = Turns(order=(0, 1), phase=1), Turns(order=(0, 1), phase=1, loss=0.2)
RANDOM = Turns(transition=((0.3, 0.7), (0.6, 0.4)), initial=(0.25, 0.75))


def task(turns: Turns | None, **change: Any) -> DesignTask:
    nodes = SensorNodes(names=("a", "b"), outputs=((0,), (1,)), buffers=(1, 1), delays=(0, 0), turns=turns)
    model = LoopModel(A=A, B=PLANT.B, C=np.eye(2), period_s=1.0, tau_max=0, d_max=0, sensors=nodes)
    return DesignTask(**{"model": model, "delayed_plant": PLANT, "initial_state": X0} | change)


@pytest.mark.parametrize(
    ("turns", "asked", "phases"),
    [
        (CYCLE, {"memory": 1}, UNIFORM),
        (CYCLE, {"memory": 1, "start": "given"}, [0.0, 1.0]),
        (LOSSY, {"uses": "current-packet"}, np.kron([0.8, 0.2], UNIFORM)),
        (LOSSY, {"uses": "newest", "start": "given"}, np.kron([0.8, 0.2], [0.0, 1.0])),
        (LOSSY, {"uses": "last-packets", "window": 1}, np.kron([0.8, 0.2], UNIFORM)),
        (RANDOM, {"uses": "current-packet"}, UNIFORM),
        (RANDOM, {"uses": "last-packets", "window": 1}, [0.25, 0.75]),
    ],
)
def test_no_gains_nearby_cost_less_from_the_start_that_is_named(turns: Turns, asked: dict[str, Any], phases: Any) -> None:
    """What the gains cost and what they may look at is computed here from the phases as they are written above."""
    made = HistoricalDesigned(input_weight=0.1, **asked).solve(task(turns))
    K, nodes = made.history(), task(turns).model.nodes
    last = made.uses == "last-packets"
    mask = window_mask(nodes, window_of(turns, len(K)), K.shape[1] - 1) if last else mask_of(nodes, K.shape[1] - 1, made.uses)
    plant = DelayedPlant(A=A, delayed=PLANT.delayed, B=PLANT.B, weight=PLANT.weight, input_weight=np.array([[0.1]]))
    start = Start(moment=np.outer(X0, X0) if asked.get("start") == "given" else np.eye(2), phases=np.array(phases))

    def value(gains: np.ndarray) -> float:
        each = phase_gains(gains, nodes, made.uses)
        return cost(close(plant, each.gains, each.transition), start)

    least, rng = value(K), np.random.default_rng(1)
    for _ in range(6):
        step = 1e-3 * rng.normal(size=K.shape) * mask[:, :, None, :]
        up, down = value(K + step), value(K - step)
        assert min(up, down) > least and abs(up - down) < 0.05 * (up + down - 2.0 * least)


@pytest.mark.parametrize(
    ("asked", "loop", "field"),
    [
        ({}, task(CYCLE, delayed_plant=None), "kind"),
        ({}, task(RANDOM), "uses"),
        ({}, task(LOSSY), "uses"),
        ({"uses": "newest"}, task(None), "uses"),
        ({"uses": "last-packets"}, task(None), "uses"),
        ({"start": "given", "peak_input": 1.0, "uses": "current-packet"}, task(LOSSY), "peak_input"),
    ],
)
def test_what_no_gains_are_designed_for_is_refused_by_its_field(asked: dict[str, Any], loop: DesignTask, field: str) -> None:
    with pytest.raises(FieldError) as caught:
        HistoricalDesigned(**asked).solve(loop)
    assert caught.value.field == field
