"""The messages of a topic as columns, gathered chunk by chunk: what is kept is numbers, not a Python object for each record."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.log.read.arrays import StructuredArray, assemble, run_dtype
from hil.log.read.mcap_content import MESSAGE_PAYLOAD_AT, MESSAGE_TIME_AT
from hil.log.records import Schema

TOGETHER: Final = 4096
"""Messages that are turned into numbers together."""


class Columns:
    """One topic's records, in the order of the log.

    Args:
        schema: of the topic.
    """

    def __init__(self, schema: Schema) -> None:
        self.schema = schema
        self._messages: list[bytes] = []
        self._parts: list[StructuredArray] = []

    def add(self, messages: list[bytes]) -> None:
        """Take messages, framing included.

        Raises:
            HilError: if one is not as the schema says.
        """
        self._messages += messages
        if len(self._messages) >= TOGETHER:
            self._assemble()

    def _assemble(self) -> None:
        self._parts.append(
            assemble(self.schema, self._messages, payload_at=MESSAGE_PAYLOAD_AT, time_at=MESSAGE_TIME_AT)
        )
        self._messages = []

    def array(self) -> StructuredArray:
        """Return all records as one array; the columns are empty afterwards."""
        if self._messages:
            self._assemble()
        parts, self._parts = self._parts, []
        return np.concatenate(parts) if parts else np.empty(0, run_dtype(self.schema))
