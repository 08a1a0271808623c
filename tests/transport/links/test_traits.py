"""What a link says of itself by its URI alone: ours, and a plug-in's."""

from __future__ import annotations

from pathlib import Path

import pytest

from transport import CanFraming, Link, LinkTraits, Role, TransportError
from transport.installed import Folder, Point
from transport.links.opening import worker_channel
from transport.links.traits import on_zenoh, traits_of


@pytest.mark.parametrize(
    ("uri", "commanders"),
    [
        ("memory:", "no other process: the controller runs in the rig's own"),
        ("local:", "no other process: the controller runs in the rig's own"),
        ("can:virtual:x", "no other process: the controller runs in the rig's own"),
        ("can:hil:rig0", "any process of this user (no key set)"),
        ("can:socketcan:can0", "anyone on the CAN bus can0 (no key set)"),
        ("can:udp_multicast:239.74.163.2", "any process on this machine (no key set)"),
        ("can:udp_multicast:239.74.163.2?hop_limit=1", "anyone on the local network (no key set)"),
        ("can:socketcan:can0?auth=keys/frames.key", "holders of the key keys/frames.key"),
        ("zenoh:", "any process of this user (no key set)"),
        ("zenoh:tcp/10.0.0.1:7447?lan=1", "anyone who reaches 10.0.0.1:7447 (no key set)"),
        ("zenoh:tls/10.0.0.1:7447?keys=keys", "holders of a certificate of keys/ca.pem that is called controller"),
    ],
)
def test_a_link_names_the_possible_commanders_of_a_rig(uri: str, commanders: str) -> None:
    assert traits_of(uri).commanders == commanders


@pytest.mark.parametrize(
    ("mode", "who"), [(0o700, "of this user"), (0o770, "that may write in {}"), (0o707, "that may write in {}")]
)
def test_a_socket_accepts_users_who_may_write_in_its_folder(tmp_path: Path, mode: int, who: str) -> None:
    tmp_path.chmod(mode)
    assert on_zenoh(f"unixsock-stream/{tmp_path}/rig", {}) == f"any process {who.format(tmp_path)}"


def test_a_link_says_whether_it_has_frames_threads_keys_and_another_process() -> None:
    can, zenoh, local = (traits_of(uri) for uri in ("can:hil:a?fd=0&base=0x200&ids=0x201", "zenoh:", "local:"))
    assert can.can == CanFraming(base=0x200, fd=False, names_nodes=True) and can.can.frame_bytes == 8
    assert (zenoh.can, zenoh.own_threads, zenoh.takes) == (None, True, {"tls", "login"})
    assert all(traits_of(uri).one_process for uri in ("memory:", "local:", "can:virtual:x")) and not can.one_process
    assert (can.own_threads, can.in_process, can.takes, local.in_process) == (False, False, {"messages"}, True)


@pytest.mark.parametrize("uri", ["can:hil", "zenoh:127.0.0.1", "cam:hil:a", "nonsense", "can:hil:a?base=7", "can:hil:a?auth="])
def test_what_is_no_link_has_no_traits(uri: str) -> None:
    with pytest.raises(TransportError, match="link '"):
        traits_of(uri)


class Bus:
    """A plug-in that opens links and says what they are."""

    def __call__(self, uri: str, role: Role) -> Link:
        raise TransportError(uri)

    def traits(self, uri: str) -> LinkTraits:
        return LinkTraits(commanders="whoever holds the cable", can=CanFraming(base=0x300), own_threads=True)


class Liar(Bus):
    def traits(self, uri: str) -> LinkTraits:
        return "CAN"  # type: ignore[return-value]


def test_a_plug_in_says_what_its_links_are(monkeypatch: pytest.MonkeyPatch) -> None:
    found = {"bus": Bus(), "liar": Liar(), "mute": print}
    points = [Point("hil.links", name, f"nowhere:{name}", Folder("")) for name in (*found, "gone")]
    load = Point.load
    monkeypatch.setattr("transport.links.opening.points", lambda begin: points)
    monkeypatch.setattr(Point, "load", lambda point: found[point.name] if point.name in found else load(point))
    said = traits_of("bus:7")
    assert (said.commanders, said.can, said.own_threads) == ("whoever holds the cable", CanFraming(base=0x300), True)
    assert said.can is not None and said.can.frame_bytes == 64, "CAN FD, where it does not say otherwise"
    for name in ("mute", "gone"):
        assert traits_of(f"{name}:7") == LinkTraits(commanders=f"unknown: the link {name!r} does not say whom it lets in")
    with pytest.raises(TransportError, match=r"traits gave 'CAN', expected transport\.LinkTraits"):
        traits_of("liar:7")
    assert traits_of("bus:7?auth=frames.key").commanders == "holders of the key frames.key"


def test_eight_workers_share_a_bus_and_no_ninth() -> None:
    assert worker_channel("can:socketcan:vcan0?base=0x300", 7) == "can:socketcan:vcan0?base=0x200"
    assert worker_channel("zenoh:unixsock-stream/tmp/x", 2) == "zenoh:unixsock-stream/tmp/x-2"
    assert worker_channel("zenoh:tls/h:7447?keys=k", 1) == "zenoh:tls/h:7448?keys=k"
    with pytest.raises(TransportError, match="identifiers for 8 workers; start fewer"):
        worker_channel("can:socketcan:vcan0", 8)
