"""A DDS domain that a group of processes has to itself on this machine."""

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
    """Claim a DDS domain that is empty, for the length of a `with` block, and yield its id.

    The claim is a bound socket: it holds for every user and container that shares the network of
    this machine, tools of ROS 2 respect it, and it ends with the process. A program that joins a
    domain without a claim is detected by the ports that it has bound.

    Raises:
        NoDomainError: All domains are taken.
    """
    # Not the domain that this process had last: late messages of its nodes find nobody.
    first = os.getpid() + next(_CLAIMS)
    for i in range(len(DOMAINS)):
        domain = DOMAINS[(first + i) % len(DOMAINS)]
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as claim:
            if _bind(claim, _CLAIM_PORT + domain) and _is_empty(domain):
                yield domain
                return
    raise NoDomainError(
        f"no DDS domain of {DOMAINS[0]} to {DOMAINS[-1]} is free: other programs on this machine "
        "use them all, or ports cannot be bound; end some of them"
    )


def _is_empty(domain: int) -> bool:
    """Return whether a domain has no participant; each would have bound one of its even ports."""
    begin = _DDS_PORT + _PORTS * domain
    for port in range(begin, begin + _PORTS, 2):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            if not _bind(probe, port):
                return False
    return True


def _bind(endpoint: socket.socket, port: int) -> bool:
    """Bind a socket to a port on all interfaces, and return whether that was possible."""
    try:
        endpoint.bind(("", port))
    except OSError:
        return False
    return True
