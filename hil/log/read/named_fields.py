"""Records of a topic whose missing field is answered with the nearest one, as a missing topic is."""

from __future__ import annotations

from typing import Any

import numpy as np

from hil.errors import unknown_name


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
