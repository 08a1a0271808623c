"""Named signals over zenoh: what a subscriber of ten lines reads is what is logged, by our reader of CDR and by another."""

from __future__ import annotations

import json
import re
from importlib import resources
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import pytest
import zenoh
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hil.log.records import Field, Schema
from tests.ports import free_port
from tests.waiting import LIMIT_S
from transport import TransportError
from transport.links.zenoh_link import config
from transport.links.zenoh_observers import SignalPublisher

SCHEMA = Schema(name="hil/msg/Probe", fields=(Field(name="angle", type="float64", unit="rad"), Field(name="late", type="uint8")))
TOPIC = "/plant/measurement"


def subscriber(endpoint: str) -> Any:
    entries = {"mode": "client", "connect/timeout_ms": 10_000, "connect/exit_on_failure": True}
    return zenoh.open(config("controller", endpoint, entries))


def guide_watch() -> Any:
    """The function that the guide shows."""
    text = (Path(str(resources.files("hil"))) / "guide" / "wire-format.md").read_text()
    (code,) = (block for block in re.findall(r"```python\n(.*?)```", text, re.S) if "def watch" in block)
    scope: dict[str, Any] = {"__name__": "guide"}
    exec(code, scope)
    return scope["watch"]


def test_the_subscriber_of_the_guide_reads_values_by_name() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    seen: SimpleQueue[dict[str, float]] = SimpleQueue()
    with SignalPublisher(f"zenoh:{endpoint}?name=arm", {TOPIC: (SCHEMA.name, SCHEMA.text)}) as publisher:
        put = publisher.observers[TOPIC]
        session = subscriber(endpoint)
        try:
            watching = guide_watch()(session, name="arm", show=seen.put)
            bare: SimpleQueue[bytes] = SimpleQueue()
            also = session.declare_subscriber("hil/arm/signals/**", lambda sample: bare.put(sample.payload.to_bytes()))
            payload = SCHEMA.pack(1.25, 1)
            for _ in range(round(LIMIT_S / 0.05)):  # until the declaration has come to the publisher
                put(50_000_000, payload)
                try:
                    found = seen.get(timeout=0.05)
                    break
                except Exception:
                    continue
            assert found == {"angle": 1.25, "late": 1}
            (reply,) = session.get("hil/arm/signals/schemas")
            assert json.loads(reply.ok.payload.to_string()) == {TOPIC: {"schema": SCHEMA.name, "text": SCHEMA.text}}
            store = get_typestore(Stores.EMPTY)
            store.register(get_types_from_msg(SCHEMA.text, SCHEMA.name))
            put(100_000_000, payload)
            message: Any = store.deserialize_cdr(bare.get(timeout=LIMIT_S), SCHEMA.name)  # a reader that knows nothing of ours
            assert (message.angle, message.late) == (1.25, 1)
            watching.undeclare()
            also.undeclare()
            with pytest.raises(LookupError, match="arm publishes no /plnt/x; it publishes /plant/measurement"):
                guide_watch()(session, "/plnt/x", "arm")
            with pytest.raises(LookupError, match=r"rig7 publishes no .*nothing: does it run"):
                guide_watch()(session, name="rig7")
        finally:
            session.close()
    publisher.close()
    put(0, payload)  # after the end: nothing, and no error


@pytest.mark.parametrize(
    ("uri", "said"),
    [
        ("can:hil:rig0", "expected zenoh: or zenoh:tcp/HOST:PORT"), ("zenoh:udp/127.0.0.1:1", "expected zenoh: or"),
        ("zenoh:tcp/10.0.0.1:7448", r"append \?lan=1"), ("zenoh:tcp/127.0.0.1:7448?keys=x", "no options but name"),
    ],
)  # fmt: skip
def test_where_signals_cannot_be_published_is_refused(uri: str, said: str) -> None:
    with pytest.raises(TransportError, match=said):
        SignalPublisher(uri, {})
