"""The records of a run over the Foxglove WebSocket protocol, as they come: Foxglove and Lichtblick show them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Final

from hil.errors import HilError
from hil.log.records import EVENT_SCHEMA, EVENT_SCHEMA_NAME, EVENTS_TOPIC, Channel
from hil.log.write.sinks import PayloadWriter, together
from hil.rig.loop import Loop
from hil.runtime.changes import Changes
from hil.runtime.time.clock import Clock
from hil.session import Onlooker

PORT: Final = 8765
HOST: Final = "127.0.0.1"


class Foxglove:
    """Serves the records of one run after the other on loopback; see `hil.session.Onlooker`.

    A viewer that does not keep up loses records: the server drops the oldest that wait, and the run waits for none.

    Args:
        port: 0 for any that is free.

    Raises:
        HilError: foxglove-sdk is not installed, or the port is taken.
    """

    def __init__(self, port: int = PORT) -> None:
        try:
            import foxglove
        except ImportError as error:
            raise HilError("--foxglove: needs foxglove-sdk: pip install 'hilrig[foxglove]'") from error
        self._sdk, self._context = foxglove, foxglove.Context()
        self._channels: list[Any] = []
        self.clock: Clock | None = None  # it paces nothing, and changes nothing
        self.changes: Changes | None = None
        try:
            self._server = foxglove.start_server(name="hilrig", host=HOST, port=port, context=self._context)
        except RuntimeError as error:
            raise HilError(f"--foxglove {port}: {error}; --foxglove 0 takes a free port") from error
        self.url = f"ws://{HOST}:{self._server.port}"

    def __enter__(self) -> Foxglove:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.stop()

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Offer the topics of a run; raw frames stay in the log."""
        for channel in self._channels:
            channel.close()
        signals = {topic: channel.schema for topic, channel in channels.items() if not channel.schema.raw}
        schemas = {topic: (schema.name, schema.text) for topic, schema in signals.items()}
        schemas[EVENTS_TOPIC] = EVENT_SCHEMA_NAME, EVENT_SCHEMA
        made = {topic: self._channel(topic, *schema) for topic, schema in schemas.items()}
        self._channels = list(made.values())
        return {topic: partial(_log, channel.log) for topic, channel in made.items()}

    def _channel(self, topic: str, name: str, text: str) -> Any:
        schema = self._sdk.Schema(name=name, encoding="ros2msg", data=text.encode())
        return self._sdk.Channel(topic, schema=schema, message_encoding="cdr", context=self._context)

    def end(self) -> None:
        """It waits for nothing."""


def _log(log: Any, t_ns: int, payload: bytes) -> None:
    log(payload, log_time=t_ns)


class Beside:
    """An onlooker, and another one that only looks; see `hil.session.Onlooker`.

    Args:
        first: paces and changes the run.
        second: gets the records, too.
    """

    def __init__(self, first: Onlooker, second: Onlooker) -> None:
        self._first, self._second = first, second
        self.end = first.end

    @property
    def clock(self) -> Clock | None:
        """That of the first."""
        return self._first.clock

    @property
    def changes(self) -> Changes | None:
        """Those of the first."""
        return self._first.changes

    def begin(self, loop: Loop, channels: Mapping[str, Channel]) -> Mapping[str, PayloadWriter]:
        """Let both look; when the first one says that the run goes on, the second one has its topics."""
        beside = self._second.begin(loop, channels)
        return together(self._first.begin(loop, channels), beside)
