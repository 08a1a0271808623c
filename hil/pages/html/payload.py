"""What a page's script draws and saves, as one JSON text: arrays, each stored once, figures, and columns of numbers."""

from __future__ import annotations

import base64
import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

GAP = -32768
"""What stands for NaN among whole numbers."""


class Payload:
    """The arrays and figure descriptions that the page's script draws; equal arrays are stored once."""

    def __init__(self) -> None:
        self._arrays: list[dict[str, Any]] = []
        self._index: dict[bytes, int] = {}
        self.figures: list[dict[str, Any]] = []
        self._tables: list[list[dict[str, Any]]] = []

    def numbers(self, columns: Sequence[tuple[str, Sequence[Any]]]) -> int:
        """Store the numbers of a plot that the script does not draw, for whoever saves them, and return its number.

        Args:
            columns: heading and cells of each; floats that are not finite become empty.
        """
        self._tables.append([{"name": name, "values": [_told(cell) for cell in cells]} for name, cells in columns])
        return len(self._tables) - 1

    def add(self, values: npt.NDArray[np.float64]) -> int:
        """Store an array and return its number: int16 for small whole numbers, float32 where that is exact enough."""
        whole = np.where(np.isnan(values), GAP, values)
        if np.all(np.abs(whole) <= -GAP) and np.array_equal(whole, np.round(whole)):
            return self._store("i2", whole.astype("<i2").tobytes())
        finite = values[np.isfinite(values)]
        largest = float(np.abs(finite).max(initial=0.0))
        if largest > float(np.finfo(np.float32).max):
            return self._store("f8", values.astype("<f8").tobytes())
        narrow = values.astype("<f4")
        steps = np.abs(np.diff(finite))
        steps = steps[steps > 0]
        rounding = largest * 6e-8
        # y needs no more than a ten-thousandth of what is drawn; x needs its samples kept apart. One test serves both.
        enough = steps.size == 0 or rounding < max(0.05 * float(steps.min()), 1e-5 * float(np.ptp(finite)))
        return self._store("f4", narrow.tobytes()) if enough else self._store("f8", values.astype("<f8").tobytes())

    def _store(self, kind: str, data: bytes) -> int:
        key = kind.encode() + data
        if key not in self._index:
            self._index[key] = len(self._arrays)
            self._arrays.append({"t": kind, "d": base64.b64encode(data).decode("ascii")})
        return self._index[key]

    def json(self) -> str:
        """Return the JSON for a script element: no `<`, so nothing in it can end the element."""
        content = {"arrays": self._arrays, "figures": self.figures, "tables": self._tables}
        text = json.dumps(content, separators=(",", ":"), allow_nan=False)
        return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _told(cell: Any) -> Any:
    return None if isinstance(cell, float) and not math.isfinite(cell) else cell
