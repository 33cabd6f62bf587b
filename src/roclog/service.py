"""Word to a supervising systemd: ready, alive, stopping. Silent where there is none."""

from __future__ import annotations

import os
import socket


def notify(state: str) -> None:
    """Send one sd_notify datagram, like ``READY=1``; see sd_notify(3)."""
    address = os.environ.get("NOTIFY_SOCKET", "")
    if not address:
        return
    if address.startswith("@"):
        address = "\0" + address[1:]
    try:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as out:
            out.sendto(state.encode(), address)
    except OSError:
        return  # the supervisor went away; recording goes on without it
