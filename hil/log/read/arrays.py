"""From the bytes of many records to one structured array, without touching them one by one."""

from __future__ import annotations

from collections.abc import Sequence
from struct import Struct
from typing import Any, Final

import numpy as np

from hil.errors import HilError, unknown_name
from hil.log.records import CDR_HEADER, TIME_FIELD, Schema

StructuredArray = np.ndarray[Any, np.dtype[np.void]]
_CDR: Final = int.from_bytes(CDR_HEADER, "little")
_LENGTH: Final = Struct("<I")


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


def run_dtype(schema: Schema) -> np.dtype[np.void]:
    """Fields of a run's array: ``t_ns``, the schema's numbers, and ``data`` (bytes objects) where frames are raw."""
    fields: list[tuple[str, Any]] = [(TIME_FIELD, "<i8")]
    fields += [(name, schema.dtype.fields[name][0]) for name in schema.dtype.names or () if schema.dtype.fields]
    if schema.raw:
        fields.append((schema.fields[-1].name, object))
    return np.dtype(fields)


def assemble(
    schema: Schema, records: Sequence[bytes], *, payload_at: int = 0, time_at: int | None = None,
    times: Sequence[int] = (),
) -> StructuredArray:
    """One array of equal records.

    Args:
        schema: layout of the payloads.
        records: each holds one payload at its end.
        payload_at: where the payload begins in a record.
        time_at: where the time (i64, little endian) stands in a record; else ``times`` are taken.
        times: nominal session times in ns.

    Returns:
        shape (len(records),). See ``run_dtype``.

    Raises:
        HilError: if a record is of another length than its schema says, or is no little-endian CDR.
    """
    out = np.empty(len(records), run_dtype(schema))
    if not len(records):
        return out
    if schema.raw:
        records, data = _split_raw(schema, records, payload_at)
        out[schema.fields[-1].name] = data
    table = _table(schema, records, payload_at, time_at)
    out[TIME_FIELD] = table[TIME_FIELD] if time_at is not None else np.asarray(times, np.int64)
    for name in schema.dtype.names or ():
        out[name] = table[name]
    return out


def _split_raw(
    schema: Schema, records: Sequence[bytes], payload_at: int
) -> tuple[list[bytes], np.ndarray[Any, np.dtype[np.object_]]]:
    """Records without their ``uint8[]``, and the bytes of it."""
    start, stop = payload_at + schema.data_offset, payload_at + 4 + schema.dtype.itemsize
    for index, record in enumerate(records):
        if len(record) < start or len(record) - start != _LENGTH.unpack_from(record, start - 4)[0]:
            raise HilError(f"record {index} of {schema.name}: {len(record) - payload_at} bytes, not as its length states")
    data = np.empty(len(records), object)
    data[:] = [record[start:] for record in records]
    return [record[:stop] for record in records], data


def _table(schema: Schema, records: Sequence[bytes], payload_at: int, time_at: int | None) -> StructuredArray:
    """The records' fixed part as numpy sees it: one dtype with holes over all of their bytes."""
    size = payload_at + 4 + schema.dtype.itemsize
    for index, record in enumerate(records):
        if len(record) != size:
            raise HilError(
                f"record {index} of {schema.name}: {len(record) - payload_at} bytes, expected {size - payload_at}"
            )
    columns = [("_cdr", "<u4", payload_at)]  # a name that no field can have
    if time_at is not None:
        columns.append((TIME_FIELD, "<i8", time_at))
    for name, (kind, offset, *_) in (schema.dtype.fields or {}).items():
        columns.append((name, kind.str, payload_at + 4 + offset))
    names, formats, offsets = zip(*columns)
    layout = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
    table: StructuredArray = np.frombuffer(b"".join(records), layout)
    if (table["_cdr"] != _CDR).any():
        raise HilError(f"record {int(np.argmax(table['_cdr'] != _CDR))} of {schema.name}: no little-endian CDR")
    return table
