"""Every kind of file, frame and option that hil takes from outside: real ones to damage, and what reads them."""

from __future__ import annotations

import contextlib
import faulthandler
import io
import json
import os
import resource
import struct
import tempfile
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any

import click
import numpy as np

from design.tracking import TrackingProblem
from design.tracking.design_file import load_design
from design.tracking.gain_cache import design_of, read_entry
from hil.cli.can import _decode, database_of
from hil.cli.option_types import NumberList
from hil.cli.terminal import message_lines
from hil.errors import HilError
from hil.experiment import Seconds, load_experiment, parse_experiment, shipped
from hil.files import mat_child
from hil.files.arrays import MOST_NUMBERS, _of_npy, numbers_from_file
from hil.log import decode_event, encode_event
from hil.log.recordings import packet_records
from hil.log.recordings.read import read_recording
from hil.measure.identification_records import read_signal_table
from hil.pages.live.script import read_script
from hil.rig.named_files import read_traffic
from hil.sweeps import SweepStore
from hil.sweeps.points import grid, latin_hypercube
from plants import FMU
from plants.errors import FieldError
from plants.fmu import _digest
from tests.hostile.logs import foreign_log, motor, our_log, read_log
from tests.hostile.mutation import OF_BYTES, OF_TEXT, Edit
from tests.plants.fmu.test_fmu import CART, LINEAR, REAL, VERSION_2
from transport import ControlPacket, SensorPacket, dbc_path, decode, encode_control, encode_sensor
from transport.laws.trace import read_ages
from transport.links import TransportError, key_file
from transport.links.authentication import read_key
from transport.links.traits import traits_of
from transport.links.zenoh_access import Access
from transport.links.zenoh_observers import _json_object
from transport.wire import tag_of

FOLDER = shipped()["dc-motor-hinf"].parent
DESIGN = FOLDER / "designs" / "dc-motor-bursty-h2-sojourns.json"
TEXTS = (
    "dc-motor-hinf", "dc-motor-packets", "dc-motor-two-nodes", "multisensor-event", "omni-push", "smjls-robust", "vtol-fault",
)  # fmt: skip
Real = Callable[[], Sequence[bytes]]
Refusals = tuple[type[Exception], ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class Boundary:
    """One boundary at which foreign bytes come in.

    Args:
        real: bytes that are read.
        attack: reads bytes, in a folder of its own; false where they were refused without an exception.
        count: damaged inputs of `make test-hostile`.
        refusals: what may be raised: roots of errors that ``hil`` prints as one message, or what its caller makes one of.
        edits: how the bytes are damaged.
    """

    real: Callable[[], Sequence[bytes]]
    attack: Callable[[Path, bytes], bool]
    count: int
    refusals: tuple[type[Exception], ...] = field(default=(HilError,))
    edits: Sequence[Edit] = OF_TEXT


def _text(data: bytes) -> str:
    """Text as a shell hands it over."""
    return data.decode(errors="surrogateescape").replace("\0", "")


def _in_file(name: str, read: Callable[[Path], object]) -> Callable[[Path, bytes], bool]:
    def attack(place: Path, data: bytes) -> bool:
        path = place / name
        path.write_bytes(data)
        path.chmod(0o600)
        return read(path) is not None

    return attack


def _of_text(read: Callable[[str], object]) -> Callable[[Path, bytes], bool]:
    return lambda _place, data: read(_text(data)) is not None


# Files of numbers


def _saved(save: Callable[[Any], object]) -> bytes:
    out = io.BytesIO()
    save(out)
    return out.getvalue()


def _arrays(suffix: str) -> Callable[[], list[bytes]]:
    a = np.array([[1.0, 0.05], [0.0, 0.9]])

    def real() -> list[bytes]:
        from scipy.io import savemat

        if suffix == ".npz":
            return [_saved(lambda f: np.savez(f, A=a, n=np.arange(3))), _saved(lambda f: np.savez_compressed(f, A=a))]
        if suffix == ".npy":
            return [_saved(partial(np.save, arr=each)) for each in (a, a.astype("<f4"), np.asfortranarray(a), a.astype(">i8"))]
        if suffix == ".mat":
            kinds: list[dict[str, Any]] = [{"do_compression": False}, {"do_compression": True}, {"format": "4"}]
            return [_saved(partial(savemat, mdict={"A": a, "s": "x"}, **kind)) for kind in kinds]
        return [b"# A\n1.0,0.05\n0,9e-1\n"]

    return real


def _numbers(suffix: str) -> Callable[[Path, bytes], bool]:
    key = {} if suffix in (".csv", ".npy") else {"key": "A"}
    return _in_file(f"a{suffix}", lambda path: numbers_from_file({"file": path.name} | key, "A", str(path.parent), 2))


def _mat_in_a_fork(_place: Path, data: bytes) -> bool:
    """Read as the process for MATLAB's files does, without its third of a second: its reader may end the process it runs in."""
    import scipy.io  # noqa: F401 (once, and not in each fork)

    read, write = os.pipe()
    child = os.fork()
    if child == 0:
        code = 1
        faulthandler.disable()  # a reader that is ended is what this looks for
        try:
            resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
            resource.setrlimit(resource.RLIMIT_CPU, (mat_child.MOST_CPU_S, mat_child.MOST_CPU_S))
            found = mat_child.npy_or_reason(data, "A", MOST_NUMBERS)
            with open(write, "wb") as out:
                out.write(found.encode(errors="replace") if isinstance(found, str) else found)
            code = 2 if isinstance(found, str) else 0
        finally:
            os._exit(code)
    os.close(write)
    with open(read, "rb") as file:
        said = file.read()
    _, how = os.waitpid(child, 0)
    status = os.waitstatus_to_exitcode(how)
    if status == 1:
        raise RuntimeError("the reader of MATLAB's files raised")
    if status != 0:
        raise HilError(said.decode())
    return _of_npy(said) is not None


# CAN logs


@cache
def _signals() -> Any:
    return database_of(dbc_path().read_text(encoding="utf-8"))


def _decoded(path: Path) -> bool:
    with contextlib.redirect_stdout(io.StringIO()):
        _decode(_signals(), path)
    return True


def _can_log(suffix: str) -> Callable[[], list[bytes]]:
    def real() -> list[bytes]:
        import can

        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / f"x{suffix}"
            with can.Logger(path) as out:  # type: ignore[abstract]
                for k, frame in enumerate(_frames() * 3):
                    out(can.Message(timestamp=1.0 + k, arbitration_id=0x100 + 0x40 * (k % 2), data=frame, is_fd=True,
                                    is_extended_id=False))  # fmt: skip
            return [path.read_bytes()]

    return real


# Recordings, traffic and scripts


def _recording(path: Path) -> bool:
    packet_records(read_recording([path]))
    return True


@cache
def bus_log() -> bytes:
    """A log of 300 frames that differ."""
    return "".join(f"({1e9 + k:.6f}) can0 123#{k:08X}\n" for k in range(300)).encode()


def _pair_of_logs(path: Path) -> bool:
    other = path.with_name("other.log")
    other.write_bytes(bus_log())
    packet_records(read_recording([path, other]))
    return True


def ping() -> bytes:
    """A capture of 300 echoes, Ethernet and IPv4, as `tcpdump -w` writes it."""
    out = struct.pack("<IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, 1)
    for k in range(300):
        for kind, at_us in ((8, 0), (0, 1500 + k % 7)):
            addresses = (b"\n\0\0\1", b"\n\0\0\2")[:: 1 if kind == 8 else -1]
            data = b"\0" * 12 + b"\x08\0" + struct.pack(">BBHHHBBH", 0x45, 0, 28, 0, 0, 64, 1, 0) + b"".join(addresses)
            data += struct.pack(">BBHHH", kind, 0, 0, 77, k)
            out += struct.pack("<IIII", 1_700_000_000 + k, at_us, len(data), len(data)) + data
    return out


def _table(head: str, row: Callable[[int], str]) -> bytes:
    return "\n".join([head, *map(row, range(300))]).encode()


PACKETS = [
    _table("latency_ms", lambda k: "lost" if k % 9 == 4 else f"1.{k % 7}"),
    _table("sent_s [s],received_s [s]", lambda k: f"{k},{k}.{k % 7 + 1}"),
    _table("sent_s,rtt_s", lambda k: f"{k},0.0{k % 7 + 1}"),
]  # fmt: skip


def units() -> list[bytes]:
    """Archives that describe a unit, packed in four ways; their library is none, and nothing loads it."""

    def packed(how: int) -> bytes:
        out = io.BytesIO()
        with zipfile.ZipFile(out, "w", how) as file:
            file.writestr("modelDescription.xml", VERSION_2.format(variables="".join(REAL.format(*each) for each in CART)))
            file.writestr("binaries/linux64/cart.so", b"\x7fELF")
        return out.getvalue()

    return [*map(packed, (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA))]


def _unit(path: Path) -> bool:
    return bool(_digest(path)) and bool(FMU(file=path.name, **LINEAR)._found(path).identifier)


TRAFFIC = [b"can_id,period,length,node,jitter\n0x123,10 ms,8,a,1 ms\n291,0.02,4,,\n"]
BUS = b"""VERSION ""
NS_ :
BS_:
BU_: pump
BO_ 291 state: 8 pump
 SG_ level : 0|16@1+ (0.1,0) [0|100] "l" Vector__XXX
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 291 20;
"""
SCRIPT = [b'{"slot": 4, "field": "reference", "value": [1.0]}\n\n{"slot": 9, "field": "network.sc.law", "value": {"age": 1}}\n']


# The rest


def _frames() -> list[bytes]:
    rows = ((0.1,), (0.2,))
    return [
        encode_sensor(SensorPacket(7, 0, 350_000_000, (0.5,), reference=(3.0,), nonce=99, counter=1)),
        encode_control(ControlPacket(7, 350_000_000, 0, 0, 1, rows, echo=99, counter=1)),
    ]


def _frame(_place: Path, data: bytes) -> bool:
    tag_of(data)
    return decode(data) is not None


@cache
def scalar() -> TrackingProblem:
    """A problem of one state: its certificate costs little."""
    return TrackingProblem(A=[[0.9]], B=[[1.0]], C=[[1.0]], sc=[[1.0]], ca=[[1.0]], R=0.1, objective="h2", starts=1)


@cache
def entry() -> bytes:
    """A cache entry of `scalar`."""
    from design.tracking.synthesis import solve

    found = solve(scalar())
    return json.dumps({"gains": found.gains.tolist(), "starts": list(found.starts), "evaluations": 3}).encode()


def _cache_entry(path: Path) -> object:
    return read_entry(path, lambda stored: design_of(stored, scalar()))


@cache
def sweep_file() -> bytes:
    """The head of a sweep, and three rows."""
    with tempfile.TemporaryDirectory() as folder:
        with SweepStore(Path(folder) / "s", motor(), ("sse",)):
            pass
        return (Path(folder) / "s").read_bytes() + b'{"seed": 3, "sse": 1.5}\n{"seed": 4, "sse": null}\n{"seed": 5, "sse": 2}\n'


def _sweep(path: Path) -> bool:
    with SweepStore(path, motor(), ("sse",)):
        return True


def _uri(uri: str) -> bool:
    key_file(uri)
    return bool(traits_of(uri).commanders)


SMALL = shipped()["dc-motor-local"].read_text()
LINKS = [b"zenoh:tls/127.0.0.1:7447?keys=keys&controller=x", b"can:hil:rig0?auth=k&base=0x100", b"can:socketcan:can0?fd=0"]
TABLES = [b"t_s,u [V],y\n0.0,1,2\n0.1,,3\n0.2,1,4\n0.4,2,5\n", b"time,y,u\n0,1,2\n1,2,3\n2,3,4\n"]
CHANGES = [
    b"plant.gain=150", b"seed=3", b"reference.0.at='0.2 s'", b"network.sc.law={kind='constant', age=1}", b"limits.state.angle=3",
]  # fmt: skip
KEYS = [b"00112233445566778899aabbccddeeff\n", b"0f" * 32]
TOLD = json.dumps({"experiment": "x", "period_ns": 5, "session": "s"}).encode()
EVENT = encode_event(5, "safety", "limit", slot=3, severity="error", data={"x": [1, 2.5, None]})
SHOWN = b"hil: \x1b[2Jx.toml: [red]plant[/]: 5"
CALLED = (HilError, ValueError)
"""`design` and `transport` promise a ValueError of a file; what calls them in hil adds the field's path to it."""


def _experiments() -> list[bytes]:
    return [shipped()[name].read_bytes() for name in TEXTS]


def _whole(text: str) -> object:
    return NumberList(whole=True).convert(text, None, None)


def _login(path: Path) -> object:
    return Access(role="rig", peer="controller", tls={}, users=str(path)).config("hil")


def _table() -> dict[str, Boundary]:
    def text(count: int, *real: bytes, read: Callable[[str], object], refusals: Refusals = (HilError,)) -> Boundary:
        return Boundary(real=lambda: real, count=count, attack=_of_text(read), refusals=refusals)

    def file(count: int, name: str, real: Real, read: Callable[[Path], object], refusals: Refusals = (HilError,)) -> Boundary:
        return Boundary(real=real, count=count, attack=_in_file(name, read), refusals=refusals)

    def raw(count: int, real: Real, attack: Callable[[Path, bytes], bool], refusals: Refusals = (HilError,)) -> Boundary:
        return Boundary(real=real, count=count, attack=attack, refusals=refusals, edits=OF_BYTES)

    return {
        "experiment": file(30_000, "x.toml", _experiments, lambda path: load_experiment(str(path))),
        "set": text(10_000, *CHANGES, read=lambda change: parse_experiment(SMALL, sets=[change])),
        "duration": text(80_000, b"10 ms", b"1.5e-3 s", b"2 min", read=Seconds.parse, refusals=CALLED),
        "number list": text(60_000, b"0,1,6..8", b"0..20", read=_whole, refusals=(click.UsageError,)),
        "grid": text(60_000, b"period=10ms,20ms", b"plant.gain=150,[1, 2]", read=lambda asked: grid([asked])),
        "range": text(10_000, b"period=10ms:50ms", b"x=1:2e3", read=lambda asked: latin_hypercube([asked], 2)),
        "link": text(60_000, *LINKS, read=_uri, refusals=(TransportError,)),
        "message": text(40_000, SHOWN, read=message_lines, refusals=()),
        "design": file(20_000, "d.json", lambda: [DESIGN.read_bytes()], load_design, CALLED),
        "cache entry": file(20_000, "e.json", lambda: [entry()], _cache_entry, ()),
        "sweep": file(40_000, "s", lambda: [sweep_file()], _sweep),
        "trace": file(80_000, "t.csv", lambda: [b"age\n0\n1\n2\n0\n", b"# x\n0,1\n3,2\n"], read_ages, CALLED),
        "signal table": file(80_000, "t.csv", lambda: TABLES, lambda path: read_signal_table(path, ("u", "y"))),
        "csv": Boundary(real=_arrays(".csv"), count=50_000, attack=_numbers(".csv")),
        "npy": raw(40_000, _arrays(".npy"), _numbers(".npy")),
        "npz": raw(30_000, _arrays(".npz"), _numbers(".npz")),
        "mat": raw(400, _arrays(".mat"), _numbers(".mat")),
        "mat, in a fork": raw(30_000, _arrays(".mat"), _mat_in_a_fork),
        "log": raw(30_000, lambda: [our_log()], read_log),
        "foreign log": raw(20_000, lambda: [foreign_log(True), foreign_log(False)], read_log),
        "event": raw(60_000, lambda: [EVENT], lambda _place, data: bool(decode_event(data))),
        "candump": file(20_000, "x.log", _can_log(".log"), _decoded),
        "blf": raw(20_000, _can_log(".blf"), _in_file("x.blf", _decoded)),
        "packets": file(20_000, "x.csv", lambda: PACKETS, _recording),
        "capture of ping": raw(20_000, lambda: [ping()], _in_file("x.pcap", _recording)),
        "pair of CAN logs": file(4_000, "x.log", lambda: [bus_log()], _pair_of_logs),
        "traffic": file(20_000, "x.csv", lambda: TRAFFIC, read_traffic),
        "FMU": raw(8_000, units, _in_file("x.fmu", _unit), (FieldError,)),
        "DBC": file(8_000, "x.dbc", lambda: [BUS], read_traffic),
        "script of a live run": file(20_000, "x.jsonl", lambda: SCRIPT, read_script),
        "key": file(40_000, "k", lambda: KEYS, lambda path: read_key(str(path)), (TransportError,)),
        "passwords": file(40_000, "u", lambda: [b"controller:secret\nother:word\n"], _login, (TransportError,)),
        "frame": raw(120_000, _frames, _frame, ()),
        "reported": raw(40_000, lambda: [TOLD], lambda _place, data: _json_object(data) is not None, ()),
    }


BOUNDARIES = _table()
