"""ROS domains for tests, in which no arm runs."""

from __future__ import annotations

import itertools
import os
import socket

# Above the ports that Linux hands out to whoever asks for any, up to the last one there is.
_DOMAINS = range(215, 233)
# DDS: the first participant of a domain listens there, the others two ports further each.
_FIRST_PORT, _PORTS_OF_DOMAIN, _OF_PARTICIPANT = 7410, 250, 2
# Participants that are looked for: one that has been left over is among the first.
_LOOKED_FOR = 16
_numbers = itertools.count(os.getpid())


def next_domain() -> int:
    """Return a domain in which nobody is.

    Raises:
        RuntimeError: there is none.
    """
    for _ in _DOMAINS:
        domain = _DOMAINS[next(_numbers) % len(_DOMAINS)]
        if not any(_is_taken(_FIRST_PORT + domain * _PORTS_OF_DOMAIN + i * _OF_PARTICIPANT)
                   for i in range(_LOOKED_FOR)):
            return domain
    raise RuntimeError(f'somebody is in each ROS domain from {_DOMAINS[0]} to {_DOMAINS[-1]}')


def _is_taken(port: int) -> bool:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind(('', port))
        except OSError:
            return True
    return False
