"""Random experiments whose nodes take turns, have clocks, share a bus, or whose ages are recorded; and two references for them.

`grown` runs the rig itself, where nothing is drawn, and sees what the state grows by. `moments` has no ages at all: it keeps the
values that were sent, slot by slot, and iterates E X X' over every mode of the network.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import product
from math import lcm
from typing import Any

import numpy as np

from hil.api.experiment_source import load_experiment
from hil.compose import compose
from hil.rig.loop import Loop
from hil.runtime.virtual import simulate

Case = tuple[dict[str, Any], Callable[[Loop], float]]
PERIOD_S = 0.1
SLOTS = 480


def plant(rng: np.random.Generator, n: int, outputs: int) -> dict[str, Any]:
    A = rng.normal(size=(n, n))
    A += (rng.uniform(-1.0, 1.2) - np.linalg.eigvals(A).real.max()) * np.eye(n)
    return {
        "kind": "state-space", "A": A.tolist(), "B": rng.normal(size=(n, 1)).tolist(), "C": np.eye(n)[:outputs].tolist(),
        "initial_state": rng.normal(size=n).tolist(),
    }  # fmt: skip


def experiment(rng: np.random.Generator, plant: dict[str, Any], **changes: Any) -> dict[str, Any]:
    names = [f"y{i + 1}" for i in range(len(plant["C"]))]
    sets = {
        "plant": plant, "limits": {"watchdog_slots": 10_000}, "reference": [], "disturbance": [], "allow_uncertified": True,
        "period": f"{round(1000 * PERIOD_S)} ms", "duration": f"{SLOTS * PERIOD_S:g} s",
        "network.sc": {"max_age": 2, "law": constant(0)}, "network.ca": {"max_age": 2, "law": constant(0)},
        "network.nodes": {f"n{i}": {"outputs": [name]} for i, name in enumerate(names)},
    }  # fmt: skip
    return sets | changes


def constant(age: int) -> dict[str, Any]:
    return {"kind": "constant", "age": age}


def trace(rng: np.random.Generator) -> dict[str, Any]:
    ages = [0]
    for _ in range(int(rng.integers(1, 7))):
        ages.append(int(rng.integers(0, min(ages[-1] + 1, 2) + 1)))
    return {"kind": "trace", "ages": ages}


def markov(rng: np.random.Generator) -> dict[str, Any]:
    return {"kind": "markov", "matrix": rng.dirichlet(np.ones(2), 2).tolist()}


def local(rng: np.random.Generator, p: int) -> dict[str, Any]:
    return {"kind": "local", "gain": (rng.normal(size=(1, p)) * rng.uniform(0.2, 4.0)).tolist()}


def table(rng: np.random.Generator, p: int, labels: int = 3) -> dict[str, Any]:
    selection = str(rng.choice(["constant", "generated", "applied", "previous", "both"]))
    rows = {"constant": 1, "both": 9}.get(selection, 3)
    gains = rng.normal(size=(1, 1, 1, p)) * rng.uniform(0.2, 3.0) * rng.uniform(0.5, 1.5, (labels, rows, 1, 1))
    return {"kind": "send-all", "selection": selection, "gains": gains.tolist()}


def recorded(rng: np.random.Generator) -> Case:
    """Traces on one or both links."""
    p = int(rng.integers(1, 3))
    made = experiment(rng, plant(rng, int(rng.integers(p, 4)), p))
    del made["network.nodes"]
    made |= {"controller": table(rng, p)}
    which = int(rng.integers(3))
    made["network.sc"] = {"max_age": 2, "law": constant(int(rng.integers(3))) if which == 0 else trace(rng)}
    made["network.ca"] = {"max_age": 2, "law": constant(int(rng.integers(3))) if which == 1 else trace(rng)}
    return made, grown


def with_nodes(rng: np.random.Generator, p: int, controller: dict[str, Any]) -> dict[str, Any]:
    made = experiment(rng, plant(rng, int(rng.integers(p, 4)), p), controller=controller)
    for node in made["network.nodes"].values():
        node["law"] = trace(rng) if rng.random() < 0.2 else constant(int(rng.integers(0, 3)))
    made["network.ca"] = {"max_age": 2, "law": constant(int(rng.integers(0, 2)))}
    return made


def clocked(rng: np.random.Generator) -> Case:
    p = int(rng.integers(1, 3))
    made = with_nodes(rng, p, table(rng, p))
    for node in made["network.nodes"].values():
        every = int(rng.integers(1, 4))
        node["clock"] = {"every": every, "phase": int(rng.integers(every))}
    return made, grown


def in_turns(rng: np.random.Generator) -> Case:
    p = int(rng.integers(2, 4))
    reported = p == 2 and rng.random() < 0.5
    controller = table(rng, p, 9 if reported else 3) | ({"ages": [3, 3]} if reported else {})
    made = with_nodes(rng, p, controller)
    order = [*rng.permutation(p).tolist(), *rng.integers(p, size=int(rng.integers(0, 2))).tolist()]
    bus = {"kind": "round-robin", "nodes": [f"n{i}" for i in order], "phase": int(rng.integers(len(order)))}
    return made | {"network.media": {"bus": bus}}, grown


def on_a_bus(rng: np.random.Generator) -> Case:
    p = int(rng.integers(2, 4))
    made = with_nodes(rng, p, table(rng, p))
    for node in made["network.nodes"].values():
        every = int(rng.integers(p, 6))
        node["clock"] = {"every": every, "phase": int(rng.integers(every))}
    bus = {"kind": "can-arbitration", "nodes": list(made["network.nodes"]), "frames": int(rng.integers(1, 3))}
    return made | {"network.media": {"bus": bus}}, grown


def smith(rng: np.random.Generator) -> Case:
    made = with_nodes(rng, 1, {"kind": "smith", "gain": [[float(rng.normal() * rng.uniform(0.2, 4.0))]]})
    if rng.random() < 0.4:
        made["network.nodes"]["n0"]["clock"] = {"every": 2}
    return made, grown


def output_feedback(rng: np.random.Generator) -> Case:
    p, c = 2, int(rng.integers(1, 3))
    A = rng.normal(size=(c, c))
    A *= rng.uniform(0.1, 0.95) / np.abs(np.linalg.eigvals(A)).max()
    controller = {
        "kind": "output-feedback", "A": A.tolist(), "B": rng.normal(size=(c, p)).tolist(),
        "C": (0.3 * rng.normal(size=(1, c))).tolist(), "D": (rng.normal(size=(1, p)) * rng.uniform(0.2, 3.0)).tolist(),
    }  # fmt: skip
    return with_nodes(rng, p, controller), grown


@cache
def shipped_gains() -> Any:
    return np.array(compose(load_experiment("multisensor-ours"), certify=False).controller.gains)  # type: ignore[attr-defined]


def historical(rng: np.random.Generator) -> Case:
    """The gains of the shipped experiment, at another size, on commands that come later."""
    gains = (shipped_gains() * rng.uniform(0.2, 2.5)).tolist()
    return {
        "base": "multisensor-ours", "controller": {"kind": "historical", "gains": gains}, "allow_uncertified": True,
        "limits": {"watchdog_slots": 10_000}, "duration": f"{SLOTS * 0.05:g} s",
        "network.ca": {"max_age": 3, "law": constant(int(rng.integers(1, 4)))},
    }, grown  # fmt: skip


def drawn(rng: np.random.Generator) -> Case:
    """Clocks, turns by chance, losses and Markov ages together, over one gain."""
    p = int(rng.integers(1, 3))
    made = experiment(rng, plant(rng, int(rng.integers(p, 4)), p), controller=local(rng, p))
    for node in made["network.nodes"].values():
        node["law"] = markov(rng) if rng.random() < 0.5 else constant(int(rng.integers(0, 3)))
        every = int(rng.integers(1, 4))
        node["clock"] = {"every": every, "phase": int(rng.integers(every))}
    made["network.ca"] = {"max_age": 2, "law": markov(rng) if rng.random() < 0.5 else constant(int(rng.integers(0, 2)))}
    if p == 2:
        loss = float(rng.choice([0.0, 0.1, 0.3]))
        bus: dict[str, Any] = {"kind": str(rng.choice(["random", "round-robin"])), "nodes": ["n0", "n1"], "loss": loss}
        if bus["kind"] == "random" and rng.random() < 0.5:
            bus["matrix"] = rng.dirichlet(np.ones(2), 2).tolist()
        made["network.media"] = {"bus": bus}
    return made, moments


def packets(rng: np.random.Generator) -> Case:
    """Two nodes whose packets have a latency each, and are lost."""
    made = experiment(rng, plant(rng, int(rng.integers(2, 4)), 2), controller=local(rng, 2))
    for node in made["network.nodes"].values():
        node["law"] = {"kind": "packet", "latency": f"{rng.integers(10, 250)} ms", "loss": float(rng.choice([0.05, 0.2, 0.4]))}
    made["network.ca"] = {"max_age": 2, "law": markov(rng) if rng.random() < 0.5 else constant(int(rng.integers(0, 2)))}
    return made, moments


def drawing_clocks(rng: np.random.Generator) -> Case:
    """Clocks with jitter or a random phase, over one gain and networks without delay."""
    p = int(rng.integers(1, 3))
    made = experiment(rng, plant(rng, int(rng.integers(p, 4)), p), controller=local(rng, p))
    for n, node in enumerate(made["network.nodes"].values()):
        every = int(rng.integers(2, 5))
        node["clock"] = {"every": every, "jitter": int(rng.integers(1 - (n > 0), every))}
        node["clock"] |= {"random_phase": True} if rng.random() < 0.4 else {"phase": int(rng.integers(every))}
    return made, moments_of_clocks


FAMILIES: dict[str, Callable[[np.random.Generator], Case]] = {
    "recorded ages": recorded, "clocks": clocked, "round robin": in_turns, "bus": on_a_bus, "Smith predictor": smith,
    "output feedback over nodes": output_feedback, "history with late commands": historical, "turns and losses by chance": drawn,
    "packets of two nodes": packets, "clocks that draw": drawing_clocks,
}  # fmt: skip


def composed(changes: dict[str, Any]) -> Loop:
    sets = dict(changes)
    return compose(load_experiment(sets.pop("base", "dc-motor-h2"), **sets))


def grown(loop: Loop) -> float:
    """What |X|^2 is multiplied by in a slot, X all states of a cycle, in a run of the rig."""
    states = simulate(loop, 0, ["/plant/state"]).arrays["/plant/state"]
    x = np.array([states[s.name] for s in loop.experiment.plant.states], dtype=float).T
    size = np.linalg.norm(x, axis=1)
    reported = (size > 1e-25) & (size < 1e25)  # a packet carries single precision
    x = x[: len(x) if reported.all() else int(np.argmin(reported))]
    width = min(60, len(x) // 4)
    at = (len(x) - width) // 3 + width
    early, late = (float(np.linalg.norm(part)) for part in (x[at - width : at], x[-width:]))
    return float((late / early) ** (2.0 / (len(x) - at)))


def moments(loop: Loop) -> float:
    """Growth of E|X|^2 per slot, X = (x, what was sent last in each of the last slots, the commands under way)."""
    e, K = loop.experiment, np.array(loop.controller.gain)  # type: ignore[attr-defined]
    A, B, C = loop.model.A, loop.model.B, loop.model.C
    n, p, D = len(A), len(C), 2
    kept = 4  # o_0, ..., o_3 of every output
    size = n + kept * p + D
    clocks = [sensor.clock for sensor in loop.rig.sensors]
    laws = [_chain(sensor.law, e) for sensor in loop.rig.sensors] + [_chain(e.network.ca.law, e)]
    alone = [float(getattr(sensor.law, "loss", 0.0)) for sensor in loop.rig.sensors]  # of every node's packets for themselves
    medium = e.network.media["bus"] if e.network.media else None
    cycle = lcm(*(c.every for c in clocks), len(loop.rig.sensors))
    turns = [(i, medium.transition()[j][i]) for j in range(2) for i in range(2)] if medium and medium.kind == "random" else []
    chances = np.array([w for _, w in turns]).reshape(2, 2) if turns else np.ones((1, 1))
    modes = list(product(range(cycle), range(len(chances)), *(range(len(law[0])) for law in laws)))
    index = {mode: i for i, mode in enumerate(modes)}
    joint = chances
    for law in laws:
        joint = np.kron(joint, law[1])
    per_slot = len(modes) // cycle
    order = [loop.rig.media[0].nodes[i] for i in range(p)] if medium else []
    steps: list[list[tuple[float, np.ndarray]]] = []
    for t, turn, *at in modes:
        now = [n_ for n_ in range(p) if clocks[n_].every == 1 or t % clocks[n_].every == clocks[n_].phase]
        if medium:
            whose = order[turn] if turns else order[t % p]
            now = [n_ for n_ in now if n_ == whose]
        loss = medium.loss if medium else 0.0
        outcomes = [(1.0 - loss, now), (loss, [])] if loss and now else [(1.0, now)]
        for n_, share in enumerate(alone):
            outcomes = [
                (w * v, who) for w, got in outcomes for v, who in ((1.0 - share, got), (share, [i for i in got if i != n_])) if v
            ]
        each = []
        for chance, through in outcomes:
            sent = np.zeros((kept, p, size))
            for l in range(p):
                own = np.zeros((kept, size))
                own[:, n + l : n + kept * p : p] = np.eye(kept)
                sent[0, l] = np.pad(C[l], (0, size - n)) if l in through else own[0]
                sent[1:, l] = own[:-1]
            r = np.array([sent[laws[l][0][at[l]], l] for l in range(p)])
            u = [K @ r, *np.eye(size)[size - D :][:, None]]
            F = np.zeros((size, size))
            F[:n, :n] = A
            F[:n] += B @ u[laws[-1][0][at[-1]]]
            F[n : n + kept * p] = sent.reshape(kept * p, size)
            F[size - D], F[size - D + 1] = u[0][0], u[1][0]
            each.append((chance, F))
        steps.append(each)
    M = np.zeros((len(modes), size, size))
    M[:per_slot] = np.eye(size) / per_slot
    total, marks = 0.0, {}
    span = 12 * cycle * 5
    for k in range(3 * span):
        after = np.zeros_like(M)
        t = k % cycle
        moved = np.array([sum(w * F @ M[i] @ F.T for w, F in steps[i]) for i in range(t * per_slot, (t + 1) * per_slot)])
        later = (t + 1) % cycle
        after[later * per_slot : (later + 1) * per_slot] = np.einsum("ij,iab->jab", joint, moved)
        norm = float(np.trace(after.sum(axis=0)))
        if not norm > 0.0:
            return 0.0
        M, total = after / norm, total + np.log(norm)
        marks[k + 1] = total
    assert index
    return float(np.exp((marks[3 * span] - marks[2 * span]) / span))


def moments_of_clocks(loop: Loop) -> float:
    """Growth of E|X|^2 per slot, X = (x, what each node sent last); a mode: slots since each sample was due, and its jitter."""
    K = np.array(loop.controller.gain)  # type: ignore[attr-defined]
    A, B, C, clocks = loop.model.A, loop.model.B, loop.model.C, [sensor.clock for sensor in loop.rig.sensors]
    n, p = len(A), len(C)
    of_each = [list(product(range(clock.every), range(clock.jitter + 1))) for clock in clocks]
    modes = {mode: i for i, mode in enumerate(product(*of_each))}
    F, chances, M = (np.zeros((len(modes), *shape)) for shape in ((n + p, n + p), (len(modes),), (n + p, n + p)))
    for mode, i in modes.items():
        known = np.eye(p, n + p, k=n)
        for l, (slot, late) in enumerate(mode):
            if slot == late:
                known[l] = np.pad(C[l], (0, p))
        F[i, :n] = np.hstack([A, np.zeros((n, p))]) + B @ K @ known
        F[i, n:] = known
        after = [
            [(slot + 1, late)] if slot + 1 < clock.every else [(0, again) for again in range(clock.jitter + 1)]
            for clock, (slot, late) in zip(clocks, mode)
        ]
        following = [modes[each] for each in product(*after)]
        chances[i, following] = 1.0 / len(following)
        if all(clock.random_phase or slot == -clock.phase % clock.every for clock, (slot, _) in zip(clocks, mode)):
            M[i] = np.eye(n + p)
    total, slots = 0.0, 1200
    for k in range(2 * slots):
        M = np.einsum("ij,iab->jab", chances, F @ M @ F.transpose(0, 2, 1))
        norm = float(np.trace(M.sum(axis=0)))
        M, total = M / norm, total + np.log(norm) * (k >= slots)
    return float(np.exp(total / slots))


def _chain(law: Any, e: Any) -> tuple[list[int], np.ndarray]:
    if law.kind == "constant":
        return [law.age], np.ones((1, 1))
    if law.kind == "packet":
        late = float(law.latency.split()[0]) / 1000.0 - e.timing.deadline * PERIOD_S
        return [max(0, int(np.ceil(late / PERIOD_S - 1e-9)))], np.ones((1, 1))
    matrix = np.array(law.matrix)
    return list(range(len(matrix))), matrix
