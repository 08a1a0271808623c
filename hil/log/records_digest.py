"""The SHA-256 of what a run recorded: in virtual time the same on every machine, for one experiment and one seed.

A log also says which packages and commit made it, and holds a certificate, whose last digits depend on LAPACK; the SHA-256 of the
file covers these too.
"""

from __future__ import annotations

import hashlib

from hil.log.read.arrays import StructuredArray
from hil.log.run import Run


def records_sha256(run: Run) -> str:
    """Return the SHA-256 of every record of every topic but ``/events``: topic, field and bits, in the order of their names."""
    digest = hashlib.sha256()
    for topic in sorted(run.schemas):
        records = run.numbers(topic)
        if not len(records):
            continue
        for name in next(run.pieces(topic)).dtype.names or ():
            digest.update(f"{topic} {name} {len(records)}\n".encode())
            for piece in run.pieces(topic):  # a long log is never whole in memory
                digest.update(_bytes_of(piece, name))
    return digest.hexdigest()


def _bytes_of(records: StructuredArray, name: str) -> bytes:
    column = records[name]
    if column.dtype.hasobject:  # raw frames, of any length
        return b"".join(len(data).to_bytes(4, "little") + bytes(data) for data in column.tolist())
    return column.astype(column.dtype.newbyteorder("<")).tobytes()
