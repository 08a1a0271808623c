"""A controller that knows only the frame layout in the README: python-can, struct and the CRC; nothing of hilrig.

Usage: foreign_controller.py CHANNEL [INTERFACE]
"""

import struct
import sys
from binascii import crc_hqx

import can

GAIN, PERIOD_NS, REFERENCE, STEP_AT_NS = -0.08, 50_000_000, 3.0, 200_000_000


def main() -> None:
    with can.Bus(interface=sys.argv[2] if len(sys.argv) > 2 else "hil", channel=sys.argv[1], fd=True) as bus:
        y, sample_ns = None, -1
        for frame in bus:
            if frame.arbitration_id != 0x100:
                continue  # not the rig's sensor packet
            crc, kind, flags, seq, stamp = struct.unpack_from("<HBBIq", frame.data)
            if kind != 0x11 or crc != crc_hqx(bytes(frame.data[2:]), 0xFFFF):
                continue
            if not flags & 0x80:  # not EMPTY: there is a sample
                (y,), sample_ns = struct.unpack_from("<f", frame.data, 16), stamp
            if flags & 0x40:  # MORE: another frame of this slot follows
                continue
            now_ns = seq * PERIOD_NS if seq != 0xFFFFFFFF else 0
            r = REFERENCE if now_ns >= STEP_AT_NS else 0.0
            u = GAIN * (y - r) if y is not None else 0.0
            tau = (now_ns - sample_ns) // PERIOD_NS if y is not None else -1
            # kind 0x12, selection 0 ("constant": one row for every delay), one row of one input, padded to 32 bytes
            body = struct.pack("<BBIqqhBBf", 0x12, 0, seq, sample_ns, now_ns, min(tau, 32767), 1, 1, u).ljust(30, b"\0")
            data = struct.pack("<H", crc_hqx(body, 0xFFFF)) + body
            bus.send(can.Message(arbitration_id=0x140, is_extended_id=False, is_fd=True, data=data))


if __name__ == "__main__":
    main()
