"""A small network between two interfaces: forwards Ethernet frames, drops some of them and delays all.

python relay.py FIRST SECOND LOSS DELAY COUNTS: LOSS is a share, DELAY in seconds each way; COUNTS is a file
that holds the numbers of forwarded and of dropped frames, written twice a second.
"""

from __future__ import annotations

import heapq
import random
import select
import socket
import sys
import time
from pathlib import Path

ALL_PROTOCOLS = 3  # ETH_P_ALL
ARP = b"\x08\x06"


def main(first: str, second: str, loss: float, delay: float, counts: Path) -> None:
    """Forward until killed."""
    sockets = [
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ALL_PROTOCOLS)) for _ in range(2)
    ]
    for end, name in zip(sockets, (first, second), strict=True):
        end.bind((name, 0))
        end.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 * 2**20)
    other = {sockets[0]: sockets[1], sockets[1]: sockets[0]}
    rng = random.Random(1)
    waiting: list[tuple[float, int, socket.socket, bytes]] = []
    forwarded = dropped = order = 0
    said = 0.0
    while True:
        now = time.monotonic()
        if now - said > 0.5:
            counts.write_text(f"{forwarded} {dropped}")
            said = now
        while waiting and waiting[0][0] <= now:
            _, _, out, frame = heapq.heappop(waiting)
            out.send(frame)
            forwarded += 1
        pause = min(waiting[0][0] - now, 0.1) if waiting else 0.1
        for end in select.select(sockets, [], [], pause)[0]:
            frame, address = end.recvfrom(65536)
            if address[2] == socket.PACKET_OUTGOING:
                continue
            if frame[12:14] != ARP and rng.random() < loss:
                dropped += 1
                continue
            frame = without_checksum(frame)
            order += 1
            heapq.heappush(waiting, (time.monotonic() + delay, order, other[end], frame))


def without_checksum(frame: bytes) -> bytes:
    """A frame whose UDP checksum, which the kernel leaves to a card that isn't there, is 0: not used."""
    header = 14 + 4 * (frame[14] & 15)
    first = int.from_bytes(frame[20:22], "big") & 0x1FFF == 0  # fragment
    if frame[12:14] == b"\x08\x00" and frame[23] == socket.IPPROTO_UDP and first:
        return frame[: header + 6] + b"\0\0" + frame[header + 8 :]
    return frame


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], float(sys.argv[3]), float(sys.argv[4]), Path(sys.argv[5]))
