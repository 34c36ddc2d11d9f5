"""Python reads this at its start: whatever asks for a network is refused, and noted."""

import os
import socket
import sys

_CALLS = ("socket.connect", "socket.sendto", "socket.sendmsg")
_NAMES = ("socket.getaddrinfo", "socket.gethostbyname", "socket.gethostbyaddr")


def _refuse(event: str, arguments: tuple) -> None:
    if event not in _CALLS + _NAMES:
        return
    if event in _CALLS and arguments[0].family == socket.AF_UNIX:
        return
    with open(os.environ["NETWORK_LOG"], "a", encoding="utf-8") as log:
        log.write(f"{sys.argv}: {event} {arguments[1:]}\n")
    raise OSError("no network in this run")


sys.addaudithook(_refuse)
