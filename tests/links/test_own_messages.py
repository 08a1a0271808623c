"""A rig's link to a controller that keeps its own CAN messages: what leaves, what answers, what is refused."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import can
import cantools
import pytest

from transport.links import Link, TransportError
from transport.links.opening import open_link
from transport.packets import EMPTY, MORE, ControlPacket, SensorPacket, decode, encode_control, encode_sensor
from transport.wire import HELLO, echo

DBC = Path(__file__).parents[1] / "data" / "drive.dbc"
COMMAND = 0x192  # of 29 bits
ONE = {"outputs": "Encoder.Angle", "inputs": "DriveCommand.Voltage"}


class Bench:
    """A rig's end, and beside it the controller's end as python-can has it."""

    def __init__(self, dbc: Path = DBC, **options: str) -> None:
        said = "&".join(f"{name}={value}" for name, value in {"dbc": str(dbc), **ONE, **options}.items())
        self.link: Link = open_link(f"can:hil:bench?{said}", "rig")
        self.bus = can.Bus("bench", interface="hil", fd=True)
        self.database: Any = cantools.database.load_file(dbc)
        self.slot, self.more = -1, False

    def hello(self) -> None:
        self.frame = encode_sensor(SensorPacket(HELLO, EMPTY, 0, (), nonce=1))
        self.link.send(self.frame)

    def ask(self, *y: float, flags: int = 0, **rest: Any) -> None:
        """Send a packet of the next slot, or another one of the same after MORE."""
        self.slot += not self.more
        self.more = bool(flags & MORE)
        self.frame = encode_sensor(SensorPacket(self.slot, flags | (0 if y else EMPTY), 1000 * self.slot, y, **rest))
        self.link.send(self.frame)

    def seen(self, count: int = 1) -> dict[str, dict[str, float]]:
        """The next messages that reach the controller, and no other."""
        found = {}
        for _ in range(count):
            frame = self.bus.recv(20.0)
            assert frame is not None
            message = self.database.get_message_by_frame_id(frame.arbitration_id)
            found[message.name] = message.decode(frame.data)
        assert self.bus.recv(0.05) is None
        return found

    def command(self, volts: float, *, field: float = 0.0, **change: Any) -> None:
        data = struct.pack("<hf", round(volts * 1000), field)
        self.bus.send(can.Message(**{"arbitration_id": COMMAND, "is_extended_id": True, "data": data, **change}))

    def answer(self, timeout_s: float = 20.0) -> ControlPacket | None:
        data = self.link.receive(timeout_s)
        packet = None if data is None else decode(data)
        assert packet is None or isinstance(packet, ControlPacket)
        return packet

    def greet(self) -> None:
        """A controller has said a word: the rig may begin."""
        self.hello()
        self.seen()
        self.command(0.0)
        assert self.answer() is not None

    def close(self) -> None:
        self.link.close()
        self.bus.shutdown()


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    made = Bench(**getattr(request, "param", {}))
    yield made
    made.close()


def with_options(**options: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("bench", [options], indirect=True, ids=[""])


def test_a_measurement_is_a_signal_and_the_command_that_follows_is_its_answer(bench: Bench) -> None:
    bench.greet()
    bench.ask(12.345)
    assert bench.seen() == {"Encoder": {"Angle": 12.35, "Alive": 0, "Temperature": 25, "Torque": 0}}, "nearest; start values"
    bench.command(-3.25)
    answer = bench.answer()
    assert answer is not None
    assert (answer.seq, answer.rows, answer.selection, answer.sample_ns) == (0, ((-3.25,),), 0, 0)
    assert answer.echo == echo([bench.frame]), "of the frames of this slot"
    assert bench.answer(0.05) is None, "one answer"


@with_options(outputs="Encoder.Angle*57.29577951308232", references="Setpoint.Wanted*-10", counters="Encoder.Alive")
def test_factors_references_and_counters(bench: Bench) -> None:
    bench.greet()
    for k in range(18):
        bench.ask(math.pi / 2, reference=(2.0,))
        said = bench.seen(2)
        assert [*said] == ["Setpoint", "Encoder"], "who answers the sample knows the reference"
        assert said["Encoder"]["Angle"] == 90 and said["Setpoint"] == {"Wanted": -20}
        assert said["Encoder"]["Alive"] == (k + 2) % 16, "after that of the hello"


@pytest.mark.parametrize(
    ("value", "angle"), [(1e9, 300), (-1e9, -300), (math.inf, 300), (299.996, 300), (0.0049, 0), (-0.0051, -0.01)]
)
def test_what_a_signal_cannot_hold_is_the_nearest_that_it_can(bench: Bench, value: float, angle: float) -> None:
    bench.greet()
    bench.ask(value)
    assert bench.seen()["Encoder"]["Angle"] == angle


def test_what_is_no_number_is_not_sent_and_counts_as_dropped(bench: Bench) -> None:
    bench.greet()
    bench.ask(math.nan)
    assert bench.bus.recv(0.05) is None
    assert bench.link.counters.dropped == 1 and bench.link.counters.errors == 0


def test_until_a_controller_has_said_a_word_the_hello_is_start_values_then_nothing(bench: Bench) -> None:
    bench.hello()
    assert bench.seen()["Encoder"] == {"Angle": 0, "Alive": 0, "Temperature": 25, "Torque": 0}
    assert bench.answer(0.05) is None
    bench.command(1.0)
    answer = bench.answer()
    assert answer is not None and answer.seq == HELLO and answer.echo == echo([bench.frame])
    bench.hello()
    assert bench.answer() is not None
    assert bench.bus.recv(0.05) is None


def test_a_command_from_before_the_question_answers_nothing(bench: Bench) -> None:
    bench.greet()
    bench.ask(1.0)
    assert bench.answer(0.05) is None
    bench.command(5.0)  # too late
    bench.ask(2.0)
    assert bench.answer(0.05) is None
    bench.command(6.0)
    answer = bench.answer()
    assert answer is not None and (answer.seq, answer.rows) == (1, ((6.0,),))


@with_options(valid="30")
def test_a_command_that_is_valid_still_answers_at_once(bench: Bench) -> None:
    bench.greet()
    for volts in (1.0, 2.0):
        bench.command(volts)
        bench.ask(1.0)
        answer = bench.answer()
        assert answer is not None and answer.rows == ((volts,),)


@with_options(valid="0.000001")
def test_a_command_that_is_valid_no_longer_answers_nothing(bench: Bench) -> None:
    bench.greet()
    bench.command(1.0)
    bench.ask(1.0)
    assert bench.answer(0.05) is None
    bench.command(2.0)
    answer = bench.answer()
    assert answer is not None and answer.rows == ((2.0,),)


@with_options(references="Setpoint.Wanted")
def test_where_no_sample_arrives_the_reference_alone_leaves_and_the_last_command_stands(bench: Bench) -> None:
    bench.greet()
    bench.ask(1.0, reference=(5.0,))
    bench.seen(2)
    bench.command(4.0)
    assert bench.answer() is not None
    bench.ask(reference=(7.0,))
    assert bench.seen() == {"Setpoint": {"Wanted": 7}}
    answer = bench.answer()
    assert answer is not None and (answer.seq, answer.rows, answer.sample_ns) == (1, ((4.0,),), 0)


@with_options(fd="1")
@pytest.mark.parametrize(
    "change",
    [
        {"data": b"12345"}, {"data": b"", "is_remote_frame": True, "dlc": 6}, {"is_fd": True}, {"data": b""},
        {"data": struct.pack("<hf", 24002, 0)}, {"data": struct.pack("<hf", -24002, 0)},
    ],
    ids=["short", "remote", "FD", "empty", "above its limit", "below its limit"],
)  # fmt: skip
def test_a_frame_that_is_no_command_is_counted_and_answers_nothing(bench: Bench, change: dict[str, Any]) -> None:
    bench.greet()
    bench.ask(1.0)
    bench.command(1.0, **change)
    assert bench.answer(0.1) is None
    assert bench.link.counters.malformed == 1
    bench.command(1.0)
    assert bench.answer() is not None


@with_options(inputs="DriveCommand.Field")
@pytest.mark.parametrize("field", [math.nan, math.inf, -math.inf])
def test_a_number_that_is_none_is_no_command(bench: Bench, field: float) -> None:
    bench.greet()
    bench.ask(1.0)
    bench.command(0.0, field=field)
    assert bench.answer(0.1) is None and bench.link.counters.malformed == 1


def test_longer_frames_and_other_traffic_are_no_fault(bench: Bench) -> None:
    bench.greet()
    bench.ask(1.0)
    for identifier, extended in ((COMMAND, False), (0x140, False), (0x193, False), (COMMAND + 1, True)):
        bench.command(9.0, arbitration_id=identifier, is_extended_id=extended)
    bench.command(1.5, data=struct.pack("<hfxx", 1500, 0))
    answer = bench.answer()
    assert answer is not None and answer.rows == ((1.5,),)
    counters = bench.link.counters
    assert counters.malformed == counters.foreign == counters.errors == 0


def test_the_rig_s_own_packets_command_nothing(bench: Bench) -> None:
    """Who knows our wire format, and not the controller's messages, is no controller here."""
    bench.greet()
    bench.ask(1.0)
    data = encode_control(ControlPacket(0, 0, 0, 0, 0, ((9.0,),), echo([bench.frame]), 1))
    bench.bus.send(can.Message(arbitration_id=0x140, is_extended_id=False, is_fd=True, data=data))
    assert bench.answer(0.1) is None


@with_options(inputs="DriveCommand.Voltage,Brake.Force,DriveCommand.Field*2")
def test_inputs_of_several_messages_answer_when_all_have_come(bench: Bench) -> None:
    def brake(newtons: int) -> None:
        bench.bus.send(can.Message(arbitration_id=403, is_extended_id=False, data=bytes((newtons // 2,))))

    bench.hello()
    bench.seen()
    bench.command(0.0)
    assert bench.answer(0.05) is None
    brake(0)
    assert bench.answer() is not None
    bench.ask(1.0)
    brake(40)
    brake(44)
    assert bench.answer(0.05) is None
    bench.command(1.0, field=3.0)
    answer = bench.answer()
    assert answer is not None and answer.rows == ((1.0, 44.0, 1.5),)
    brake(60)  # before the question
    bench.ask(2.0)
    bench.command(2.0)
    assert bench.answer(0.05) is None
    brake(62)
    answer = bench.answer()
    assert answer is not None and answer.rows == ((2.0, 62.0, 0.0),)


@with_options(outputs="Encoder.Angle;,Encoder.Torque")
def test_each_node_has_its_signals_and_some_are_not_sent(bench: Bench) -> None:
    bench.greet()
    bench.ask(1.0, flags=MORE, node=0, nodes=2)
    first = bench.frame
    bench.ask(7.0, 2.5, 8.0, 9.0, node=1, nodes=2, samples=2)
    said = bench.seen()["Encoder"]
    assert (said["Angle"], said["Torque"]) == (1, 2.5), "of the newest of two samples"
    bench.command(1.0)
    answer = bench.answer()
    assert answer is not None and answer.echo == echo([first, bench.frame])
    bench.ask(flags=MORE, node=0, nodes=2)
    bench.ask(7.0, 3.5, 8.0, 9.0, node=1, nodes=2, samples=2)
    assert bench.seen()["Encoder"]["Torque"] == 3.5
    bench.ask(1.0, 2.0)
    assert bench.link.counters.dropped == 1, "two outputs where there is one"


def test_fd_messages_need_an_fd_bus_and_are_sent_as_such(tmp_path: Path) -> None:
    formats = '"StandardCAN","ExtendedCAN",' + ",".join(['"reserved"'] * 12) + ',"StandardCAN_FD","ExtendedCAN_FD"'
    defaults = f'BA_DEF_ BO_ "VFrameFormat" ENUM {formats};\nBA_DEF_DEF_ "VFrameFormat" "StandardCAN";\n'
    dbc = tmp_path / "fd.dbc"
    dbc.write_text(f'{DBC.read_text()}{defaults}BA_ "VFrameFormat" BO_ 385 14;\n')
    uri = f"can:hil:bench?dbc={dbc}&outputs=Encoder.Angle&inputs=DriveCommand.Voltage"
    with pytest.raises(TransportError, match="fd=0, and the DBC has CAN FD messages among those in use"):
        open_link(uri + "&fd=0", "rig")
    bench = Bench(dbc)
    bench.hello()
    frame = bench.bus.recv(20.0)
    bench.close()
    assert frame is not None and frame.is_fd and frame.bitrate_switch and frame.arbitration_id == 385


def test_a_second_rig_for_one_command_is_refused(bench: Bench) -> None:
    with pytest.raises(TransportError, match="another"):
        Bench(outputs="Encoder.Torque")
    Bench(inputs="Brake.Force").close()
