"""The 17 messages of the SAE benchmark, several signals in a message, as the literature on CAN uses them since 1994."""

from __future__ import annotations

from transport.can_analysis import PeriodicMessage

SIZES = (1, 2, 1, 2, 1, 2, 6, 1, 2, 2, 1, 4, 1, 1, 3, 1, 1)
PERIODS_MS = (1000, *(5,) * 5, *(10,) * 4, *(100,) * 4, *(1000,) * 3)

SAE = [
    PeriodicMessage(name=f"SAE {i + 1}", identifier=0x100 + i, length=size, period_ns=period * 1_000_000)
    for i, (size, period) in enumerate(zip(SIZES, PERIODS_MS))
]
BOUNDS_MS = (
    1.416, 2.016, 2.536, 3.136, 3.656, 4.256, 5.016, 8.376, 8.976, 9.576, 10.096, 19.096, 19.616, 20.136, 28.976, 29.496, 29.496,
)  # fmt: skip
BOUNDS_250_MS = (
    0.708, 1.008, 1.268, 1.568, 1.828, 2.128, 2.508, 2.768, 3.068, 3.368, 3.628, 3.968, 4.228, 4.488, 4.748, 5.008, 5.008,
)  # fmt: skip
