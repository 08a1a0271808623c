"""A controller that knows only wire version 2 and the key: python-can, struct, the CRC and CMAC; nothing of hilrig.

Usage: foreign_controller_keyed.py KEYFILE CHANNEL [INTERFACE]
"""

import struct
import sys
from binascii import crc_hqx
from pathlib import Path

import can
from cryptography.hazmat.primitives.ciphers.algorithms import AES
from cryptography.hazmat.primitives.cmac import CMAC

GAIN, PERIOD_NS, HELLO = -0.08, 50_000_000, 0xFFFFFFFF


def code(key: bytes, session: bytes, signed: bytes) -> bytes:
    mac = CMAC(AES(key))
    mac.update(session + signed)
    return mac.finalize()[:8]


def main() -> None:
    key = bytes.fromhex(Path(sys.argv[1]).read_text())
    with can.Bus(interface=sys.argv[3] if len(sys.argv) > 3 else "hil", channel=sys.argv[2], fd=True) as bus:
        session, heard, sent, y, sample_ns = b"", 0, 0, None, -1
        for frame in bus:
            data = bytes(frame.data)
            if frame.arbitration_id != 0x100 or len(data) < 40 or data[2] != 0x21 or not data[26] & 0x80:
                continue  # not the rig's sensor packet, or without a code
            _, _, flags, seq, nonce, stamp = struct.unpack_from("<HBBIQq", data)
            count = (flags & 0x3F) * data[25] + (data[26] & 0x7F)
            end = 28 + 4 * count + 4
            if len(data) < end + 8:
                continue
            (freshness,) = struct.unpack_from("<I", data, end - 4)
            new = seq == HELLO and data[8:16] != session
            now_session, last = (data[8:16], 0) if new else (session, heard)
            if freshness <= last or code(key, now_session, data[2:end]) != data[end : end + 8]:
                continue  # replayed, or forged
            if new:
                session, sent, y, sample_ns = now_session, 0, None, -1
            heard = freshness
            values = struct.unpack_from(f"<{count}f", data, 28)
            if not flags & 0x80:  # not EMPTY: there is a sample, the newest first
                y, sample_ns = values[0], stamp
            if flags & 0x40:  # MORE: another frame of this slot follows
                continue
            now_ns = seq * PERIOD_NS if seq != HELLO else 0
            r = values[-1] if data[26] & 0x7F else 0.0
            u = GAIN * (y - r) if y is not None else 0.0
            tau = (now_ns - sample_ns) // PERIOD_NS if y is not None else -1
            sent += 1
            # kind 0x22, TAGGED and selection 0, the question's nonce, one row of one input, then the counter
            body = struct.pack("<BBIQqqhBBfI", 0x22, 0x80, seq, nonce, sample_ns, now_ns, min(tau, 32767), 1, 1, u, sent)
            body = (body + code(key, session, body)).ljust(62, b"\0")
            answer = struct.pack("<H", crc_hqx(body, 0xFFFF)) + body
            bus.send(can.Message(arbitration_id=0x140, is_extended_id=False, is_fd=True, data=answer))


if __name__ == "__main__":
    main()
