"""`[[fault]]`: what a run, its log, its replay and its certificate say of faults on the time line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hil.api.experiment_source import load_experiment as made
from hil.compose import compose
from hil.compose.judged import RESTARTED
from hil.errors import ExperimentError, HilError
from hil.experiment import load_experiment, parse_experiment, shipped
from hil.experiment.schema import experiment_schema
from hil.log.read import read_run
from hil.log.topics import channels_of
from hil.log.write import MemorySink
from hil.measure.view import view_of
from hil.pages.sections.theory import section as theory_section
from hil.rig.loop import Loop
from hil.rig.session_link import link_of
from hil.runtime.nodes.actuator_node import HOLD
from hil.runtime.nodes.controller_node import ControlNode
from hil.runtime.nodes.network import FaultInjector
from hil.runtime.real.supervisor import run_real
from hil.runtime.virtual import simulate
from hil.session import run_session, simulated_session
from hil.session.replay.replay import verify
from hil.sweeps.lockstep import supports_batch
from transport.packets import EMPTY, SensorPacket, decode, encode_sensor, packet_size

MOTOR = shipped()["dc-motor-hinf"].read_text().replace('duration = "50 s"', 'duration = "3 s"') + "watchdog_slots = 40\n"
LONG = "limits.watchdog_slots=900"
BAND = ["controller={kind='local',gain=[[-0.05]]}",
        "network.nodes.s={outputs=['angle'],trigger={kind='dead-band',threshold=0.05}}"]  # fmt: skip
FIRST, END = 24, 34  # slots of 1.2 s to 1.7 s, while the step is followed


def faulty(kind: str, where: str, text: str = MOTOR, lasts: str = 'for = "500 ms"') -> str:
    free = text.replace("seed = 0", "seed = 0\nallow_uncertified = true")
    return f'{free}\n[[fault]]\nat = "1.2 s"\n{lasts}\nkind = "{kind}"\n{where}\n'


def loop_of(text: str, *, certify: bool = True) -> Loop:
    return compose(parse_experiment(text), certify=certify)


@pytest.mark.parametrize(
    ("kind", "where"),
    [(kind, f'link = "{side}"') for kind in ("cut", "corrupt", "freeze", "bus-off") for side in ("sc", "ca")]
    + [("controller-restart", "")],
)
def test_a_fault_breaks_what_it_says_is_reported_and_replayed_bit_for_bit(kind: str, where: str, tmp_path: Path) -> None:
    session = run_session(parse_experiment(faulty(kind, where)), path=tmp_path / "x.mcap")
    run = session.run
    assert session.status == 0
    reported = [(event["kind"], event["slot"]) for event in run.events if event["kind"].startswith("fault")]
    over = [] if kind == "controller-restart" else [(f"fault over: {kind}", END)]
    assert reported == [(f"fault: {kind}", FIRST), *over]
    marks = {(mark.label, round(mark.t_s, 3)) for mark in view_of(run).marks}
    assert (f"fault: {kind}", 1.2) in marks  # lines on every panel of the page
    applied, sound = run.arrays["/actuator/applied"], simulate(loop_of(MOTOR, certify=False), 0).arrays
    assert np.array_equal(run.arrays["/plant/state"]["angle"][:FIRST], sound["/plant/state"]["angle"][:FIRST])
    assert not np.array_equal(run.arrays["/plant/state"]["angle"], sound["/plant/state"]["angle"])
    held = applied["status"][FIRST:END] == HOLD
    if kind == "controller-restart" or (where == 'link = "ca"' and kind != "freeze"):
        assert held[-5:].all() and not (applied["status"][END + 2 :] == HOLD).any()
    taus = run.arrays["/controller/rows"]
    during = taus["tau"][(taus["slot"] >= FIRST) & (taus["slot"] < END)]
    if where == 'link = "sc"' and kind != "freeze":
        assert during[-1] >= END - FIRST - 1  # the newest sample that the controller has is that of before
    elif kind == "freeze":
        assert during.max() <= 2  # the time stamps do not show it
    again = verify(run)
    assert again.difference is None and again.states == 60


def test_of_a_corrupted_frame_one_bit_is_wrong_and_the_controller_refuses_it() -> None:
    loop = loop_of(faulty("corrupt", 'link = "sc"'))
    run, other = simulate(loop, 0), simulate(loop, 1)
    node, wrong = ControlNode(loop), 0
    for slot, data in zip(run.arrays["/link/sensor"]["slot"].tolist(), run.arrays["/link/sensor"]["data"]):
        node.on_frame(bytes(data))
        if decode(bytes(data)) is None:
            assert FIRST <= slot < END
            wrong += 1
    assert wrong == node.counts.malformed == END - FIRST
    drawn = [[bytes(d) for d in each.arrays["/link/sensor"]["data"] if decode(bytes(d)) is None] for each in (run, other)]
    assert drawn[0] != drawn[1]  # from the seed


def test_a_controller_off_the_bus_receives_nothing() -> None:
    run = simulate(loop_of(faulty("bus-off", 'link = "ca"'), certify=False), 0)
    packets = [decode(bytes(data)) for data in run.arrays["/link/sensor"]["data"]]
    received = {p.seq for p in packets if isinstance(p, SensorPacket) and not p.flags & EMPTY}
    assert not received & set(range(FIRST, END)) and received >= set(range(END + 3, 60))


def test_one_node_of_several_falls_silent_and_its_bus_goes_on() -> None:
    text = shipped()["multisensor-published"].read_text()
    name = next(iter(parse_experiment(text).network.nodes))
    run = simulate(loop_of(faulty("cut", f'node = "{name}"', text), certify=False), 0)
    packets = [decode(bytes(data)) for data in run.arrays["/link/sensor"]["data"]]
    received = {(p.seq, p.node) for p in packets if isinstance(p, SensorPacket) and not p.flags & EMPTY}
    slots = {node: {k for k, n in received if n == node and FIRST <= k < END} for node in range(4)}
    assert not slots[0] and all(slots[node] for node in (1, 2, 3))


def test_a_restart_forgets_the_newest_sample() -> None:
    """With `for` left out nothing is missed but what was known: zero rows until the next sample."""
    node = ControlNode(loop_of(faulty("controller-restart", "", lasts="")))
    period = 50_000_000
    ask = lambda k, y: decode(node.on_frame(encode_sensor(SensorPacket(k, 0 if y else EMPTY, k * period if y else 0, y))) or b"")  # noqa: E731
    for k in (FIRST - 1, FIRST, FIRST + 1):
        packet = ask(k, (1.0,) if k != FIRST else ())
        assert packet is not None and (packet.sample_ns < 0) == (k == FIRST)


def test_a_loop_with_faults_is_not_computed_at_once_or_predicted() -> None:
    loop = loop_of(faulty("cut", 'link = "sc"'))
    assert loop.verdict is not None and loop.verdict.digest != loop_of(MOTOR).verdict.digest  # type: ignore[union-attr]
    assert supports_batch(loop_of(MOTOR)) and not supports_batch(loop)
    assert theory_section(view_of(simulate(loop, 0), loop.experiment)) is None


@pytest.mark.parametrize("kind", ["cut", "corrupt", "freeze", "bus-off", "controller-restart"])
def test_behind_faults_that_end_a_linear_loop_is_as_stable_as_without_them(kind: str) -> None:
    restart = kind == "controller-restart"
    text = faulty(kind, "" if restart else 'link = "ca"').replace("allow_uncertified = true", "")
    verdict, without = loop_of(f'{text}[[fault]]\nat = 1\nfor = 1\nkind = "cut"\nlink = "sc"').verdict, loop_of(MOTOR).verdict
    assert verdict is not None and without is not None and verdict.certified and verdict.number == without.number
    assert verdict.reason == f"behind 2 faults on the time line, from 2 s on: {without.reason}"
    assert verdict.assumptions == without.assumptions + (RESTARTED,) * restart, "no fault may trip the watchdog"


@pytest.mark.parametrize(
    ("name", "sets", "fault", "state", "kind"),
    [
        ("dc-motor-local", [], "at=1,for=0.1,kind='cut',link='sc'", "refused", "mean-square stability"),
        ("dc-motor-h2-friction", [], "at=1,for=0.1,kind='cut',link='sc'", "certified", "practical stability"),
        ("dc-motor-h2", BAND, "at=1,for=0.1,kind='cut',link='ca'", "certified", "practical stability"),  # it took no sample
        ("smjls-robust", [], "at=1,for=0.1,kind='freeze',link='sc'", "certified", "mean-square stability"),  # modes seen late
        ("multisensor-ours", [], "at=1,for=0.1,kind='controller-restart'", "certified", "mean-square stability"),  # cost without
        ("omni-1khz", [], "at=1,for=0.1,kind='cut',link='sc'", "certified", "passivity"),  # but for what is stored then
    ],
)  # fmt: skip
def test_what_holds_from_any_state_holds_behind_a_fault(name: str, sets: list[str], fault: str, state: str, kind: str) -> None:
    sets = ["duration=3", LONG, "allow_uncertified=true", *sets, f"fault=[{{{fault}}}]"]
    verdict = compose(load_experiment(name, sets)).verdict
    assert verdict is not None and (verdict.state, verdict.kind) == (state, kind)
    assert verdict.reason.startswith("behind 1 fault on the time line, from 1.1 s on: ")
    assert any("what is stored when this begins comes back" in said for said in verdict.assumptions) == (kind == "passivity")


def test_a_controller_that_forgot_its_state_brings_an_unstable_plant_back() -> None:
    """Without commands the plant grows by 1.65 in 0.5 s; 0.64 a slot in the mean square afterwards, over 120 slots."""
    law, plant = {"kind": "markov", "matrix": [[0.6, 0.4], [0.5, 0.5]]}, {"A": [[1.0]], "B": [[1.0]], "C": [[1.0]]}
    loop = compose(made(
        "dc-motor-h2", duration=8, reference=[], disturbance=[], limits={"watchdog_slots": 30},
        plant={"kind": "state-space", "initial_state": [1.0]} | plant, network={"sc": {"law": law}, "ca": {"law": law}},
        controller={"kind": "output-feedback", "A": [[0.5]], "B": [[1.0]], "C": [[-0.5]], "D": [[-4.0]]},
        fault=[{"at": 1, "for": 0.5, "kind": "controller-restart"}, {"at": 1.7, "for": 0.3, "kind": "bus-off", "link": "ca"}],
    ))  # fmt: skip
    assert loop.verdict is not None and loop.verdict.certified
    for seed in range(5):
        x = np.abs(simulate(loop, seed, ["/plant/state"]).arrays["/plant/state"]["x1"])
        assert x[29] > 1.2 * x[21] > 0.0 and x[-1] < 1e-6


@pytest.mark.parametrize(
    ("watchdog", "faults", "certified"),
    [
        (12, "{at=1,for=0.5,kind='cut',link='ca'}", True),
        (11, "{at=1,for=0.5,kind='cut',link='ca'}", False),  # one slot more is lost where the law repeats what came in the cut
        (20, "{at=1,for=0.5,kind='cut',link='ca'},{at=1.5,for=0.5,kind='corrupt',link='ca'}", False),
        (20, "{at=1,for=0.5,kind='cut',link='ca'},{at=1.5,for=0.5,kind='corrupt',link='sc'}", True),
        (3, "{at=1,for=0.5,kind='cut',link='sc'},{at=1.2,for=0.5,kind='freeze',link='ca'}", True),
        (20, "{at=1,for=0.5,kind='cut',link='ca'},{at=9,for=5,kind='cut',link='ca'}", True),
        (11, "{at=1,for=0.5,kind='controller-restart'}", True),
        (10, "{at=1,for=0.5,kind='controller-restart'}", False),  # what was sent before serves a slot longer than in a cut
        (1, "{at=1,kind='controller-restart'}", True),
        (12, "{at=1,for=0.5,kind='bus-off',link='ca'}", True),
        (11, "{at=1,for=0.5,kind='bus-off',link='ca'}", False),
        (11, "{at=1,for=0.3,kind='controller-restart'},{at=1.35,for=0.2,kind='cut',link='ca'}", False),
        (12, "{at=1,for=0.3,kind='controller-restart'},{at=1.35,for=0.2,kind='cut',link='ca'}", True),
    ],
)
def test_a_loop_is_certified_where_no_fault_can_trip_the_watchdog(watchdog: int, faults: str, certified: bool) -> None:
    sets = ["duration=2.2", f"limits.watchdog_slots={watchdog}", f"fault=[{faults}]", "allow_uncertified=true"]
    loop = compose(load_experiment("dc-motor-hinf", sets))
    assert loop.verdict is not None and loop.verdict.certified == certified
    assert any(simulate(loop, seed, []).summary["safety"] for seed in range(40)) != certified


def test_a_law_that_loses_commands_may_trip_the_watchdog_behind_a_fault() -> None:
    """About 12 % of the runs by a cut of 10 slots, and 0.1 % without it: of 100 runs 2 to 26, but once in 10^4."""
    sets = ["duration=2", "limits.watchdog_slots=12", "fault=[{at=1,for=0.5,kind='cut',link='ca'}]"]
    loop = compose(load_experiment("dc-motor-wifi", sets))
    assert loop.verdict is not None and loop.verdict.certified
    share = "by its faults the watchdog stops at most about 12 % of the runs, of which nothing is claimed"
    assert share in loop.verdict.assumptions
    assert 2 <= sum(simulate(loop, seed, []).summary["safety"] is not None for seed in range(100)) <= 26


@pytest.mark.parametrize(("kind", "lacks"), [("cut", 7), ("bus-off", 9), ("controller-restart", 7)])
def test_a_latency_serves_what_was_sent_before_a_fault_and_delays_what_is_sent_behind_it(kind: str, lacks: int) -> None:
    """7 slots, 2 of latency, rows for 2: every run lacks `lacks` commands, and 2 % of them one more, by a loss at either end."""
    where = {} if kind == "controller-restart" else {"link": "ca"}
    for watchdog, certified, trips in ((lacks, False, range(10, 11)), (lacks + 1, True, range(4))):
        loop = compose(made(
            "dc-motor-h2", duration=2.2, fault=[{"at": 1, "for": 0.35, "kind": kind} | where], allow_uncertified=True,
            limits={"watchdog_slots": watchdog}, controller={"kind": "local", "gain": [[-0.01]]},
            network={"sc": {"law": {"kind": "constant", "age": 0}},
                     "ca": {"max_age": 2, "law": {"kind": "packet", "latency": "89 ms", "loss": 0.01}}},
        ))  # fmt: skip
        stopped = sum(simulate(loop, seed, []).summary["safety"] is not None for seed in range(10))
        assert loop.verdict is not None and loop.verdict.certified == certified and stopped in trips
        share = "by its faults the watchdog stops at most about 2 % of the runs, of which nothing is claimed"
        assert (share in loop.verdict.assumptions) == certified


@pytest.mark.parametrize(
    ("name", "sets", "fault", "why"),
    [
        ("dc-motor-hinf", [LONG], "at=1,for=2,kind='cut',link='sc'", "the cut of network.sc for 2 s, it lasts to the end"),
        ("dc-motor-hinf", [LONG], "at=1,for=2,kind='controller-restart'", "the restart of the controller for 2 s, it lasts"),
        ("dc-motor-hinf", ["limits.watchdog_slots=20"], "at=1,for=1,kind='cut',link='ca'",
         "network.ca may bring no command for 21 slots from slot 20 on, and the watchdog trips after 20"),
        ("dc-motor-busy-can", [LONG], "at=1,for=0.5,kind='bus-off',link='sc'", "error counters and queues are left"),
        ("dc-motor-busy-can", [LONG], "at=1,for=0.5,kind='bit-errors',rate=1e-4", "error counters and queues are left"),
        ("dc-motor-h2", [LONG, *BAND], "at=1,for=0.1,kind='cut',link='sc'", "network.nodes.s.trigger knows nothing"),
        ("dc-motor-h2", [LONG, *BAND], "at=1,for=0.1,kind='freeze',node='s'", "network.nodes.s.trigger knows nothing"),
        ("dc-motor-h2", [LONG, *BAND], "at=1,for=0.1,kind='bus-off',link='ca'", "network.nodes.s.trigger knows nothing"),
        ("dc-motor-h2", [LONG, *BAND], "at=1,kind='controller-restart'", "network.nodes.s.trigger knows nothing"),
        ("dc-motor-hinf-supply", [LONG], "at=1,for=0.1,kind='cut',link='sc'", "where its state is then is not known"),
        ("omni-1khz", [LONG, "limits.passivity={damping_n_s_per_m=30.0}"], "at=1,for=0.1,kind='cut',link='sc'",
         "the passivity controller at the rig adds a force"),
    ],
)  # fmt: skip
def test_a_fault_that_may_leave_something_behind_leaves_a_loop_undecided(
    name: str, sets: list[str], fault: str, why: str
) -> None:  # fmt: skip
    sets = ["duration=3", *sets]
    assert compose(load_experiment(name, sets)).verdict.certified  # type: ignore[union-attr]
    with pytest.raises(ExperimentError, match=rf"certified without .* \(1 fault\); undecided with it, as .*{why}"):
        compose(load_experiment(name, [*sets, f"fault=[{{{fault}}}]"]))


def test_faults_of_the_table_are_reported_by_their_path() -> None:
    bad = [
        ('at = -1\nfor = 1\nkind = "cut"\nlink = "sc"', "fault[0].at: -1 s is not between"),
        ('at = 1\nkind = "cut"\nlink = "sc"', "fault[0].for: missing; a fault of kind 'cut' lasts a while"),
        ('at = 1\nfor = 0\nkind = "freeze"\nlink = "ca"', "fault[0].for: 0 s, expected more"),
        ('at = 1\nfor = 1\nkind = "cut"', "fault[0].link: neither link nor node is given"),
        ('at = 1\nfor = 1\nkind = "cut"\nlink = "sc"\nnode = "a"', "fault[0].link: both link and node are given"),
        ('at = 1\nfor = 1\nkind = "cut"\nnode = "a"', "fault[0].node: there is no node 'a' (no node is named: use link)"),
        ('at = 1\nkind = "controller-restart"\nlink = "ca"', "fault[0].link: a restart of the controller takes none"),
        ('at = 1\nfor = 1\nkind = "melt"\nlink = "sc"', "of cut, corrupt, freeze, bus-off, bit-errors, controller-restart"),
        ('at = 1\nlasts = 1\nkind = "cut"\nlink = "sc"', "fault[0].lasts: unknown field; there are at, for, kind, link, node"),
    ]
    for table, message in bad:
        with pytest.raises(HilError) as reported:
            loop_of(f"{MOTOR}\n[[fault]]\n{table}\n", certify=False)
        assert message in str(reported.value), str(reported.value)
    keys = experiment_schema()["$defs"]["Fault"]["properties"]
    assert set(keys) == {"at", "for", "kind", "link", "node", "rate", "can_id"}
    assert "how long it lasts" in keys["for"]["description"]
    resolved = parse_experiment(faulty("cut", 'link = "sc"')).resolved()
    assert json.loads(json.dumps(resolved))["fault"][0]["for"] == 0.5 and "fault" not in load_experiment("dc-motor-h2").resolved()


def test_a_controller_of_another_process_is_not_restarted() -> None:
    loop = loop_of(faulty("controller-restart", ""))
    with pytest.raises(HilError, match="hil cannot restart an external controller"):
        run_real(loop, 0, link_of(loop.rig, "can:hil:empty"), MemorySink(channels_of(loop)), external=True)


def test_a_fault_that_the_run_never_reaches_is_reported(tmp_path: Path) -> None:
    late = faulty("cut", 'link = "sc"') + "\n[[fault]]\nat = \"3 s\"\nkind = \"controller-restart\"\n"
    said = "fault[1].at: 3 s lies beyond the end of the run (3 s): the restart of the controller for 0 s never happens"
    session = run_session(parse_experiment(late), path=tmp_path / "run.mcap")
    assert session.summary["problems"] == {"faults": said} == read_run(tmp_path / "run.mcap").summary["problems"]
    assert session.status == 0 and simulated_session(loop_of(late), 0).summary["problems"] == {"faults": said}
    assert simulated_session(loop_of(faulty("cut", 'link = "sc"')), 0).summary["problems"] == {}


def test_a_flipped_bit_leaves_the_length_that_a_frame_states() -> None:
    """Of 256 bits of the frame more than 10 state its length: 300 draws hit none of them with probability 1e-5 at most."""
    faults, frame = FaultInjector(compose(load_experiment("dc-motor-hinf")), 0), encode_sensor(SensorPacket(7, 0, 0, (0.5,)))
    wrong = [faults.flip(frame) for _ in range(300)]
    assert {packet_size(each) for each in wrong} == {packet_size(frame)} and len(set(wrong)) > 50
    assert {(int.from_bytes(each) ^ int.from_bytes(frame)).bit_count() for each in wrong} == {1}
