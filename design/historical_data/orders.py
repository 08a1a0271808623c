"""In which order the nodes should take their turns: every cyclic order is tried, each with its own best gains."""

from __future__ import annotations

from typing import NamedTuple

from msgspec.structs import replace

from design.controllers.sensor_nodes import SensorNodes, Turns
from design.errors import FieldError
from design.historical_data.guaranteed_cost import Start, cost, cyclic_orders, synthesise
from design.historical_data.lifted_loop import Array, DelayedPlant, close
from design.historical_data.sensor_schedule import mask_of

MOST_NODES = 6
"""(6 - 1)! = 120 orders; a search by trying all ends here."""


class OrderCost(NamedTuple):
    """An order of the nodes, the gains of least cost under it, and that cost."""

    order: tuple[int, ...]
    gains: Array
    cost: float


def orders_by_cost(plant: DelayedPlant, nodes: SensorNodes, start: Start, memory: int | None = None) -> list[OrderCost]:
    """Return every cyclic order of the nodes with its best gains, the cheapest first.

    Args:
        plant: the plant and its weights.
        nodes: who measures what, buffers and delays; their turns are not used.
        start: what the cost is averaged over.
        memory: the oldest sample that the controller uses, as `mask_of` takes it.

    Raises:
        ValueError: more nodes than can be tried.
        Infeasible: no gains stabilise the plant under some order.
    """
    count = len(nodes.names)
    if count > MOST_NODES:
        raise FieldError("nodes", f"{count} of them, at most {MOST_NODES} can be put into every order")
    found = []
    for order in cyclic_orders(count):
        gains = synthesise(plant, mask_of(replace(nodes, turns=Turns(order=order)), memory), start)
        found.append(OrderCost(order, gains, cost(close(plant, gains), start)))
    return sorted(found, key=lambda each: each.cost)
