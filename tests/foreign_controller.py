"""The controller of `hil guide wire-format`, word for word: python-can, struct and the CRC; nothing of hilrig.

Usage: foreign_controller.py CHANNEL [INTERFACE]
"""

import struct
import sys
from binascii import crc_hqx
from hashlib import sha256

import can

GAIN, PERIOD_NS = -0.08, 50_000_000


def main() -> None:
    with can.Bus(interface=sys.argv[2] if len(sys.argv) > 2 else "hil", channel=sys.argv[1], fd=True) as bus:
        y, sample_ns, asked, sent = None, -1, sha256(), 0
        for frame in bus:
            data = bytes(frame.data)
            if frame.arbitration_id != 0x100 or len(data) < 32:
                continue  # not the rig's sensor packet
            crc, kind, flags, seq, _nonce, stamp = struct.unpack_from("<HBBIQq", data)
            if kind != 0x31 or crc != crc_hqx(data[2:], 0xFFFF):
                continue
            _node, samples, references, _nodes = data[24:28]
            end = 32 + 4 * ((flags & 0x3F) * samples + references)
            values = struct.unpack(f"<{(end - 32) // 4}f", data[32:end])
            asked.update(data[2:end])
            if not flags & 0x80:  # not EMPTY: there is a sample, the newest first
                y, sample_ns = values[0], stamp
            if flags & 0x40:  # MORE: another frame of this slot follows
                continue
            echo, asked, sent = asked.digest()[:8], sha256(), sent + 1  # what was asked, in eight bytes
            now_ns = seq * PERIOD_NS if seq != 0xFFFFFFFF else 0
            r = values[-1] if references else 0.0  # the reference travels with the sample
            u = GAIN * (y - r) if y is not None else 0.0
            tau = (now_ns - sample_ns) // PERIOD_NS if y is not None else -1
            # kind 0x32, selection 0 ("constant": one row for every delay), one row of one input
            body = struct.pack("<BBI8sqqhBBIf", 0x32, 0, seq, echo, sample_ns, now_ns, min(tau, 32767), 1, 1, sent, u)
            body = body.ljust(46, b"\0")
            data = struct.pack("<H", crc_hqx(body, 0xFFFF)) + body
            bus.send(can.Message(arbitration_id=0x140, is_extended_id=False, is_fd=True, data=data))


if __name__ == "__main__":
    main()
