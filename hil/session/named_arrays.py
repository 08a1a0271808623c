"""The arrays of a session: a field that a topic has not is answered with the nearest one, as a topic is."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from hil.log.read.arrays import StructuredArray
from hil.measure.measure import unknown_name


class Records(np.ndarray[Any, np.dtype[np.void]]):
    """Records of a topic; a field of them is a plain array."""

    def __getitem__(self, key: Any) -> Any:
        """Return a field by its name, else what numpy returns.

        Raises:
            UnknownName: no field is called so.
        """
        if not isinstance(key, str):
            return super().__getitem__(key)
        if key not in (self.dtype.names or ()):
            raise unknown_name("field of this topic", key, self.dtype.names or ())
        return self.view(np.ndarray)[key]


class NamedArrays(Mapping[str, StructuredArray]):
    """Topic to records.

    Args:
        arrays: of a run.
    """

    def __init__(self, arrays: Mapping[str, StructuredArray]) -> None:
        self._arrays = arrays

    def __getitem__(self, topic: str) -> StructuredArray:
        return self._arrays[topic].view(Records)

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)
