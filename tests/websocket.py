"""A client of the WebSocket protocol (RFC 6455), as small as a test of a server needs it."""

from __future__ import annotations

import base64
import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

TEXT, BINARY, CLOSE, PING = 1, 2, 8, 9


class Client:
    """One connection.

    Args:
        end: connected to the server.
    """

    def __init__(self, end: socket.socket, port: int, protocol: str) -> None:
        self._end = end
        key = base64.b64encode(os.urandom(16)).decode()
        end.sendall(
            f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: {key}\r\nSec-WebSocket-Protocol: {protocol}\r\n\r\n".encode()
        )
        head = b""
        while not head.endswith(b"\r\n\r\n"):
            head += self._exactly(1)
        assert b" 101 " in head.split(b"\r\n")[0], head

    def _exactly(self, size: int) -> bytes:
        data = b""
        while len(data) < size:
            piece = self._end.recv(size - len(data))
            assert piece, "the server closed the connection"
            data += piece
        return data

    def receive(self) -> tuple[int, bytes]:
        """Return kind and content of the next message; a server masks nothing."""
        kind, size = self._exactly(2)
        if size >= 126:
            size = int.from_bytes(self._exactly(2 if size == 126 else 8), "big")
        return kind & 15, self._exactly(size)

    def send(self, said: Any) -> None:
        """Send a JSON object, masked as a client's are; up to 125 bytes."""
        text, mask = json.dumps(said).encode(), os.urandom(4)
        assert len(text) < 126
        self._end.sendall(bytes([0x80 | TEXT, 0x80 | len(text)]) + mask + bytes(c ^ mask[i % 4] for i, c in enumerate(text)))


@contextmanager
def connected(port: int, protocol: str) -> Iterator[Client]:
    """Give a client of a server on loopback."""
    with socket.create_connection(("127.0.0.1", port), timeout=60) as end:
        yield Client(end, port, protocol)
