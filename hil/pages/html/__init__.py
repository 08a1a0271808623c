"""Figures, blocks and pages; knows HTML and no run. How a number is written on a page and in the terminal."""

from __future__ import annotations

import math


def text_of(value: object, digits: int = 4) -> str:
    """Return a short text of a value: `digits` significant digits, a dash for what is not there.

    >>> text_of(12.0345678), text_of(1e-9), text_of(1234567), text_of(None), text_of(True), text_of(-0.5)
    ('12.03', '1.000e−9', '1\u202f234\u202f567', '–', 'yes', '−0.5')
    """
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f").replace("-", "−")
    if isinstance(value, float):
        return _float_text(value, digits)
    return str(value)


def share_text(value: float) -> str:
    """Return three decimals, so that a column of shares lines up; what has fewer than three digits then, as any number.

    >>> share_text(0.25), share_text(1234.5), share_text(0.00518531)
    ('0.250', '1234', '0.00519')
    """
    return f"{value:.3f}".replace("-", "−") if 0.1 <= abs(value) < 100.0 else text_of(value, 3)


def can_id_text(can_id: int, *, extended: bool = False) -> str:
    """Return a CAN identifier as tools for CAN write it.

    >>> can_id_text(0x1F), can_id_text(0x1F, extended=True)
    ('01F', '0000001F')
    """
    return f"{can_id:08X}" if extended else f"{can_id:03X}"


def _float_text(value: float, digits: int) -> str:
    if math.isnan(value):
        return "–"
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    size = abs(value)
    if size and (size < 1e-4 or size >= 10.0 ** (digits + 3)):
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        return f"{mantissa}e{int(exponent)}".replace("-", "−")
    whole = len(str(int(size))) if size >= 1 else 0
    text = f"{value:.{max(digits - whole, 0)}f}" if size >= 1 else f"{value:.{digits}g}"
    if "." in text and "e" not in text:
        text = text.rstrip("0").rstrip(".")
    return (text or "0").replace("-", "−")


def capital(text: str) -> str:
    """Return a text that begins with a capital; the rest stays.

    >>> capital("no run of dc-motor-H2")
    'No run of dc-motor-H2'
    """
    return text[:1].upper() + text[1:]
