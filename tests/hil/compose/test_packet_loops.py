"""Loops over packet laws: the certificate's radius is that of a loop written packet by packet, without any closed form."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import hil
from design.controllers import LinearLaw
from design.errors import FieldError
from design.networked_loop.certify import certify_loop
from design.networked_loop.closed_loop import dynamic_loop
from design.processes.delay_chain import DelayChain
from hil.compose import compose
from hil.experiment import load_experiment
from hil.measure.prediction import predict
from hil.rig.receiver import Receiver, received
from hil.sweeps.seeds import run_seeds
from transport.laws.packet import GilbertElliott, PacketLaw

Array = NDArray[np.float64]
T, DEADLINE = 0.010, 0.004
LOSSY = (
    "network.sc={max_age=0,law={kind='constant',age=0}}", "controller={kind='local',gain=[[-0.5]]}", "allow_uncertified=true",
)  # fmt: skip
AT_ONCE = DelayChain(transition=[[1.0]])


def law_of(longest: int, shares: Array, loss: float | GilbertElliott, waits: bool) -> PacketLaw:
    """A packet comes at age 0 ... longest with these probabilities."""
    ends, rows = np.cumsum(shares), [[0.0, 0.0]]
    ends[-1] = 1.0
    for age, end in enumerate(ends):
        value = 0.0 if age == 0 else DEADLINE + (age - 0.5) * T
        rows += [[rows[-1][0], value], [float(end), value]]
    return PacketLaw(latency={"table": rows}, loss=loss, reordering=not waits)


def literal_radius(
    a: Array, b: Array, c: Array, K: Array, law: PacketLaw, shares: Array, max_age: int, to_actuator: bool
) -> float:  # fmt: skip
    """Radius of the second moments of a loop, every packet with its own fate: age that it comes at, or lost.

    State: x, and of the last H slots the samples (or inputs) sent, and what the receiver used last. Mode: the channel, when each
    of the last H packets arrives, and the age of the newest that has come. First in, first out: a packet comes no sooner than
    those before it.
    """
    H, J = max(len(shares), max_age + 1) + 1, len(shares) - 1
    n, width = len(a), (b.shape[1] if to_actuator else c.shape[0])
    channel, losses = law.transition_matrix(), law.channel_losses()
    order = n + (H + 1) * width

    def step(mode: tuple[int, tuple[int, ...], int]) -> dict[tuple[int, tuple[int, ...], int], float]:
        before, due, age = mode  # due[i]: slots until the packet sent i slots ago arrives; 99 never, 0 or less has come
        found: dict[tuple[int, tuple[int, ...], int], float] = {}
        for now, fate in itertools.product(range(len(losses)), range(-1, J + 1)):
            p = channel[before, now] * (losses[now] if fate < 0 else (1.0 - losses[now]) * shares[fate])
            later = [d - 1 if d < 99 else 99 for d in due]
            own = 99 if fate < 0 else fate
            if fate >= 0 and not law.reordering:
                own = max([own, *(d for d in later if d < 99)])
            packets = [own, *later][:H]
            came = [i for i, d in enumerate(packets) if d <= 0]
            newest = min([*came, age + 1, H])
            kept = tuple(99 if i >= newest else max(d, 0) for i, d in enumerate(packets))
            to = now, kept, newest
            found[to] = found.get(to, 0.0) + p
        return {to: p for to, p in found.items() if p > 0.0}

    start = (0, (99,) * H, H)
    rows: dict[tuple[int, tuple[int, ...], int], dict[tuple[int, tuple[int, ...], int], float]] = {}
    ahead = [start]
    while ahead:
        mode = ahead.pop()
        if mode not in rows:
            rows[mode] = step(mode)
            ahead += rows[mode]
    index = {mode: i for i, mode in enumerate(rows)}
    closed = np.zeros((len(rows), order, order))
    for mode, i in index.items():
        age, A = mode[2], closed[i]
        sent = np.zeros((H, width, order))  # what was sent so many slots ago, as functions of the state
        last = np.zeros((width, order))
        last[:, order - width :] = np.eye(width)
        for j in range(1, H):
            sent[j][:, n + (j - 1) * width : n + j * width] = np.eye(width)
        x = np.eye(n, order)
        sent[0] = (K[0, 0] @ c if to_actuator else c) @ x
        if to_actuator:
            used = u = sent[age] if age <= max_age else last
        else:
            used = sent[age] if age < H else last
            u = K[min(age, max_age), 0] @ used
        A[:n] = a @ x + b @ u
        A[n : n + width] = sent[0]
        A[n + width : n + H * width, n : n + (H - 1) * width] = np.eye((H - 1) * width)
        A[order - width :] = used
    size = order * order
    operator = np.zeros((len(rows) * size, len(rows) * size))
    for mode, i in index.items():
        square = np.kron(closed[i], closed[i])
        for to, p in rows[mode].items():
            j = index[to]
            operator[j * size : (j + 1) * size, i * size : (i + 1) * size] += p * square
    from scipy.sparse import csr_matrix
    from scipy.sparse.linalg import eigs

    return float(np.abs(eigs(csr_matrix(operator), k=4, which="LM", tol=1e-10, return_eigenvectors=False)).max())


@pytest.mark.parametrize("to_actuator", [False, True])
@pytest.mark.parametrize(("longest", "max_age"), [(0, 0), (1, 0), (1, 1), (0, 1)])
@pytest.mark.parametrize("kind", ["loss", "in order"])
def test_radius_is_that_of_a_loop_packet_by_packet(longest: int, max_age: int, to_actuator: bool, kind: str) -> None:
    rng = np.random.default_rng([longest, max_age, to_actuator, kind == "loss"])
    a, b, c = np.array([[rng.uniform(0.8, 1.1)]]), np.ones((1, 1)), np.ones((1, 1))
    shares = rng.dirichlet(np.ones(longest + 1))
    law = law_of(longest, shares, float(rng.uniform(0.1, 0.4)), waits=kind == "in order")
    K = -rng.uniform(0.1, 0.9, size=(1 if to_actuator else max_age + 1, 1, 1, 1))
    chain = received("law", law, Receiver(T, DEADLINE, max_age, holds_input=to_actuator)).delays()
    assert chain is not None
    links = (AT_ONCE, chain) if to_actuator else (chain, AT_ONCE)
    found = certify_loop(a, b, c, *links, K, "constant").mean_square_radius
    assert found == pytest.approx(literal_radius(a, b, c, K, law, shares, max_age, to_actuator), rel=1e-6)


@pytest.mark.parametrize("to_actuator", [False, True])
def test_radius_over_bursts_of_loss(to_actuator: bool) -> None:
    a, b, c, K = (np.array([[v]]) for v in (1.05, 1.0, 1.0, -0.6))
    shares = np.array([0.7, 0.3])
    law = law_of(1, shares, GilbertElliott(p_gb=0.1, p_bg=0.4, loss_good=0.05, loss_bad=0.8), waits=False)
    chain = received("law", law, Receiver(T, DEADLINE, 0, holds_input=to_actuator)).delays()
    assert chain is not None
    links = (AT_ONCE, chain) if to_actuator else (chain, AT_ONCE)
    found = certify_loop(a, b, c, *links, K[None, None], "constant").mean_square_radius
    assert found == pytest.approx(literal_radius(a, b, c, K[None, None], law, shares, 0, to_actuator), rel=1e-6)


def test_a_linear_controller_is_the_table_of_one_gain() -> None:
    """xi of order 0: a law without a state is a table, asked for either way."""
    a, b, c = np.array([[1.0, 0.1], [0.0, 0.9]]), np.array([[0.0], [0.1]]), np.array([[1.0, 0.0]])
    law = law_of(1, np.array([0.6, 0.4]), 0.2, waits=False)
    sc, ca = (received("law", law, Receiver(T, DEADLINE, 1, holds_input=side)).delays() for side in (False, True))
    assert sc is not None
    assert ca is not None
    K = np.array([[-0.7]])
    linear = LinearLaw(A=np.zeros((0, 0)), B=np.zeros((0, 1)), C=np.zeros((1, 0)), D=K)
    loop, gains = dynamic_loop(a, b, c, sc, ca, linear)
    own = loop.system(gains)
    table = certify_loop(a, b, c, sc, ca, np.broadcast_to(K, (2, 1, 1, 1)), "constant").mean_square_radius
    from design.jump_linear.certificate import certify_system

    found = certify_system(own, selection="constant", output="stacked", initial=np.full(len(own.A), 1.0 / len(own.A)),
                           initial_law="uniform", between=None, hinf=False).mean_square_radius  # fmt: skip
    assert found == pytest.approx(table, rel=1e-8)


def test_held_modes_are_checked() -> None:
    with pytest.raises(FieldError, match="held"):
        DelayChain(transition=[[0.5, 0.5], [0.5, 0.5]], held=[True])
    with pytest.raises(FieldError, match="one for every output"):
        DelayChain(transition=[[1.0]], ages=[[0, 0]], held=[[True]])


def losing(loss: float) -> tuple[str, ...]:
    """The motor, its gain -0.5, and this loss on the way to an actuator that holds its input."""
    return (*LOSSY, f"network.ca={{max_age=0,law={{kind='packet',latency='1 ms',loss={loss}}}}}")


def held_radius(A: Array, B: Array, C: Array, gain: float, loss: float) -> float:
    """Radius of the second moments of x(k+1) = A x + B u, u new or held, by hand."""
    n = len(A)
    comes, held = np.zeros((2, n + 1, n + 1))
    comes[:n, :n], comes[n, :n] = A + B @ (gain * C), (gain * C)[0]
    held[:n, :n], held[:n, n:], held[n, n] = A, B, 1.0
    mean = (1.0 - loss) * np.kron(comes, comes) + loss * np.kron(held, held)
    return float(np.abs(np.linalg.eigvals(mean)).max())


def test_the_verdict_changes_where_the_threshold_of_loss_says() -> None:
    model = compose(load_experiment("dc-motor-packets", losing(0.2))).model
    low, high = 0.2, 0.3
    assert held_radius(model.A, model.B, model.C, -0.5, low) < 1.0 < held_radius(model.A, model.B, model.C, -0.5, high)
    for _ in range(40):
        middle = (low + high) / 2
        stable = held_radius(model.A, model.B, model.C, -0.5, middle) < 1.0
        low, high = (middle, high) if stable else (low, middle)
    for loss, state in ((0.2, "certified"), (low - 1e-4, "certified"), (high + 1e-4, "refused"), (0.3, "refused")):
        verdict = compose(load_experiment("dc-motor-packets", losing(loss))).verdict
        assert verdict is not None
        assert verdict.state == state, loss
        assert verdict.number == pytest.approx(held_radius(model.A, model.B, model.C, -0.5, loss), rel=1e-8)


def test_without_a_bound_the_certificate_says_what_it_neglects() -> None:
    for extra, state in (("", "undecided"), (",discard_older=2", "certified")):
        law = f"{{kind='packet',latency={{dist='gamma',a=2.0,scale='5 ms'}},loss=0.05{extra}}}"
        verdict = compose(load_experiment("dc-motor-packets", (*LOSSY, f"network.ca={{max_age=0,law={law}}}"))).verdict
        assert verdict is not None
        assert verdict.state == state
        assert ("with probability 1.2e-10" in verdict.reason) == (state == "undecided")


@pytest.mark.parametrize(("fields", "why"), [
    ("latency={trace=['10 ms','60 ms']}", "recorded trace"),
    ("latency='60 ms',reordering=false,duplication=0.1", "wait for the copies"),
])  # fmt: skip
def test_a_law_without_a_chain_leaves_the_loop_undecided_with_the_reason(fields: str, why: str) -> None:
    law = f"network.ca.law={{kind='packet',{fields}}}"
    verdict = compose(load_experiment("dc-motor-packets", (law, "allow_uncertified=true"))).verdict
    assert verdict is not None
    assert verdict.state == "undecided"
    assert why in verdict.reason


@pytest.mark.parametrize("selection", ["constant", "generated", "applied", "previous", "both"])
@pytest.mark.parametrize("order", ["true", "false"])
def test_what_runs_is_what_is_predicted(selection: str, order: str) -> None:
    """The mean of the squared error over 400 runs is that of the chain's loop; a right one is farther off once in 10^6."""
    law = "{kind='packet',latency={table=[[0,0],[1,'130 ms']]},loss=LOSS,reordering=ORDER}".replace("ORDER", order)
    rows = {"constant": 1, "both": 4}.get(selection, 2)
    gains = [[[[-0.15 / (1 + tau) - 0.02 * row]] for row in range(rows)] for tau in range(3)]
    loop = compose(load_experiment("dc-motor-packets", (
        "duration=5", "reference.0.at=0.3", "disturbance.0.at=2", "limits.watchdog_slots=90", "allow_uncertified=true",
        f"network.sc={{max_age=2,law={law.replace('LOSS', '0.02')}}}",
        f"network.ca={{max_age=1,law={law.replace('LOSS', '0.3')}}}",
        f"controller={{kind='send-all',selection='{selection}',gains={gains}}}",
    )))  # fmt: skip
    (way,) = loop.chains.arriving
    assert way.silent() > 1e-5 and way.silent(6) < 1e-6  # at rest, zeros are its answers anyway
    foretold = predict(loop, loop.experiment.slots)
    assert foretold is not None
    found = np.array([row["sse"] for row in run_seeds(loop, list(range(400)))])
    assert abs(found.mean() - foretold.sums[0].mean) < 4.9 * foretold.sums[0].sd / 20


def test_the_shipped_motor_over_packets_is_certified() -> None:
    verdict = compose(load_experiment("dc-motor-packets")).verdict
    assert verdict is not None
    assert verdict.certified
    assert verdict.number == pytest.approx(0.88183, abs=1e-5)


@pytest.mark.parametrize(("name", "norm", "error"), [("dc-motor-5g", 0.03, 0.05), ("dc-motor-wifi", 0.07, 0.05)])
def test_our_gains_are_better_than_the_published_by_a_margin(name: str, norm: float, error: float) -> None:
    """In the norm that they are made for, and in the squared error after a pulse, over 200 runs of equal draws."""
    at_8_s = ("disturbance.0.at=8", "disturbance.0.samples=1", "disturbance.0.value=[0.5]")
    pulse = ("duration=15", "reference.0.value=[0.0]", *at_8_s)
    ours = compose(load_experiment(name, pulse))
    seeds = list(range(200))
    own = np.array([row["sse"] for row in run_seeds(ours, seeds)])
    for kind in ("h2", "hinf"):
        published = compose(load_experiment(name, (*pulse, f"controller={{kind='{kind}'}}")))
        assert ours.verdict is not None
        assert published.verdict is not None
        assert ours.verdict.certified and published.verdict.certified
        assert published.verdict.details["h2_norm"] > (1.0 + norm) * ours.verdict.details["h2_norm"]
        found = np.array([row["sse"] for row in run_seeds(published, seeds)])
        better = found - (1.0 + error) * own
        assert better.mean() > 3.0 * better.std() / np.sqrt(len(seeds))


NODE = "{kind='packet',latency={table=[[0,0],[1,'LONGEST']]},loss=LOSS}"
TWO_NODES = (
    "network.nodes.angle.law=" + NODE.replace("LONGEST", "70 ms").replace("LOSS", "0.1"),
    "network.nodes.speed.law=" + NODE.replace("LONGEST", "60 ms").replace("LOSS", "0.25"),
    "network.sc.max_age=1", "network.ca={max_age=1,law=" + NODE.replace("LONGEST", "70 ms").replace("LOSS", "0.05") + "}",
    "duration=4", "reference.0.value=[0.0,0.0]", "disturbance.0.at=1", "disturbance.0.value=[0.5]",
    "limits={input=[5.0],state={angle=20.0,speed=200.0},watchdog_slots=100}",
)  # fmt: skip


@pytest.mark.parametrize("controller", [
    "{kind='designed',objective='h2',information='applied',node_ages='each',output_weights=[1.0,0.0]}",
    "{kind='local',gain=[[-0.12,-0.02]]}",
])  # fmt: skip
def test_several_nodes_over_packet_laws_are_designed_for_certified_and_predicted(controller: str) -> None:
    """The mean of the squared error over 400 runs is that of the product of the nodes' chains; wrong once in 10^6."""
    loop = compose(load_experiment("dc-motor-two-nodes", (*TWO_NODES, f"controller={controller}")))
    assert loop.verdict is not None
    assert loop.verdict.certified
    foretold = predict(loop, loop.experiment.slots)
    assert foretold is not None
    found = np.array([row["sse"] for row in run_seeds(loop, list(range(400)))])
    assert abs(found.mean() - foretold.sums[0].mean) < 4.9 * foretold.sums[0].sd / 20


@pytest.mark.parametrize(("changed", "state", "reason"), [
    ("network.sc.max_age=0", "undecided", "ages beyond 0 are not distinguished; max_age bounds them"),
    ("network.sc.law.loss={p_gb=0, p_bg=0.2, loss_good=0.0, loss_bad=0.9}", "certified", "mean-square stable"),
    ("network.sc.law.loss={p_gb=0.5, p_bg=0.05, loss_good=0.9, loss_bad=1.0}", "refused", ""),
])  # fmt: skip
def test_a_table_of_gains_over_packets_has_a_verdict_whatever_the_law(changed: str, state: str, reason: str) -> None:
    """Fewer ages than gains, a channel that never turns bad, and one that nearly always loses."""
    verdict = compose(load_experiment("dc-motor-packets", (changed, "allow_uncertified=true"))).verdict
    assert verdict is not None and verdict.state == state and reason in verdict.reason


BOUNDED = {"kind": "packet", "latency": {"dist": "uniform", "loc": "1 ms", "scale": "69 ms"}}


@pytest.mark.parametrize("information", ["tau", "applied", "both"])
def test_a_design_covers_delays_that_a_bounded_latency_never_makes(information: str) -> None:
    """`max_age` is 2, the latency reaches 1 slot: the rows that are never applied change no input."""
    loop: dict[str, Any] = {
        "controller": {"kind": "designed", "information": information}, "network.sc.law": BOUNDED, "network.ca.law": BOUNDED,
    }  # fmt: skip
    further = hil.run("dc-motor-packets", duration=3, **{"network.sc.max_age": 2, "network.ca.max_age": 2}, **loop)
    exactly = hil.run("dc-motor-packets", duration=3, **{"network.sc.max_age": 1, "network.ca.max_age": 1}, **loop)
    assert further.summary["certificate"]["state"] == "certified"
    applied = [run.arrays["/actuator/applied"]["voltage"] for run in (further, exactly)]
    assert (applied[0] == applied[1]).all() and applied[0].any()
