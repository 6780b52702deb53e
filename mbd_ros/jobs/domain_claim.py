"""Which DDS domain a group of processes may have for itself on this machine."""

import itertools
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

from mbd_ros.errors import FAILED, MbdError

DOMAINS = range(1, 102)  # those whose ports no system gives to outgoing connections
_CLAIM_PORT = 32768  # the claim of ROS 2's domain_coordinator: TCP, at this port + domain
_DDS_PORT, _PORTS = 7400, 250  # of domain 0, and in every domain (DDSI-RTPS 2.5, 9.6.2.3)
_CLAIMS = itertools.count()


class NoDomainError(MbdError):
    """No DDS domain is free on this machine."""

    exit_code = FAILED


@contextmanager
def claimed_domain() -> Iterator[int]:
    """A DDS domain id that nobody else claims, and where nobody is, for a `with` block.

    The claim is a bound socket: it holds for every user and container that shares the network of
    this machine, tools of ROS 2 respect it, and a process that crashes gives it back. Who joins a
    domain without a claim is found by the ports that it has bound.

    Raises:
        NoDomainError: All domains are taken.
    """
    # Not the domain that this process had last: late messages of its nodes find nobody.
    first = os.getpid() + next(_CLAIMS)
    for i in range(len(DOMAINS)):
        domain = DOMAINS[(first + i) % len(DOMAINS)]
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as claim:
            if _is_bound(claim, _CLAIM_PORT + domain) and _is_empty(domain):
                yield domain
                return
    raise NoDomainError(
        f"no DDS domain of {DOMAINS[0]} to {DOMAINS[-1]} is free: other programs on this machine "
        "use them all, or ports cannot be bound; end some of them"
    )


def _is_empty(domain: int) -> bool:
    """Whether no participant is in a domain: each has bound one of its even ports."""
    begin = _DDS_PORT + _PORTS * domain
    for port in range(begin, begin + _PORTS, 2):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            if not _is_bound(probe, port):
                return False
    return True


def _is_bound(own: socket.socket, port: int) -> bool:
    """Whether a socket could be bound to a port, on all interfaces."""
    try:
        own.bind(("", port))
    except OSError:
        return False
    return True
