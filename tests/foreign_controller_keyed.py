"""A controller that knows only the wire format and the key: python-can, struct, the CRC and CMAC; nothing of hilrig.

Usage: foreign_controller_keyed.py KEYFILE CHANNEL [INTERFACE]
"""

import struct
import sys
from binascii import crc_hqx
from hashlib import sha256
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
        session, heard, sent, y, sample_ns, asked = b"", 0, 0, None, -1, sha256()
        for frame in bus:
            data = bytes(frame.data)
            if frame.arbitration_id != 0x100 or len(data) < 40 or data[2] != 0x31 or not data[26] & 0x80:
                continue  # not the rig's sensor packet, or without a code
            _, _, flags, seq, _nonce, stamp = struct.unpack_from("<HBBIQq", data)
            count = (flags & 0x3F) * data[25] + (data[26] & 0x7F)
            end = 32 + 4 * count
            if len(data) < end + 8:
                continue
            counter = struct.unpack_from("<I", data, 28)[0] + (seq != HELLO) * 2**32  # it begins again at slot 0
            new = seq == HELLO and data[8:16] != session
            now_session, last = (data[8:16], 0) if new else (session, heard)
            if counter <= last or code(key, now_session, data[2:end]) != data[end : end + 8]:
                continue  # replayed, or forged
            if new:
                session, sent, y, sample_ns = now_session, 0, None, -1
            heard = counter
            values = struct.unpack_from(f"<{count}f", data, 32)
            asked.update(data[2:26] + bytes((data[26] & 0x7F,)) + data[27:end])  # without the flag TAGGED
            if not flags & 0x80:  # not EMPTY: there is a sample, the newest first
                y, sample_ns = values[0], stamp
            if flags & 0x40:  # MORE: another frame of this slot follows
                continue
            now_ns = seq * PERIOD_NS if seq != HELLO else 0
            r = values[-1] if data[26] & 0x7F else 0.0
            u = GAIN * (y - r) if y is not None else 0.0
            tau = (now_ns - sample_ns) // PERIOD_NS if y is not None else -1
            sent = 1 if seq in (0, HELLO) and heard in (1, 2**32 + 1) else sent + 1
            echo, asked = asked.digest()[:8], sha256()
            # kind 0x32, TAGGED and selection 0, what was asked in eight bytes, one row of one input
            body = struct.pack("<BBI8sqqhBBIf", 0x32, 0x80, seq, echo, sample_ns, now_ns, min(tau, 32767), 1, 1, sent, u)
            body = (body + code(key, session, body)).ljust(62, b"\0")
            answer = struct.pack("<H", crc_hqx(body, 0xFFFF)) + body
            bus.send(can.Message(arbitration_id=0x140, is_extended_id=False, is_fd=True, data=answer))


if __name__ == "__main__":
    main()
