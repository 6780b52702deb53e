"""Domains of DDS are claimed: no two groups of processes on a machine hear each other."""

import os
import signal
import socket
import subprocess
import sys
from contextlib import ExitStack

import pytest

from mbd_ros.errors import FAILED
from mbd_ros.jobs import domain_claim
from mbd_ros.jobs.domain_claim import NoDomainError, claimed_domain

PORT = 30000  # of claims among tests
CLAIM = """import sys
from mbd_ros.jobs import domain_claim
if sys.argv[1:]:
    domain_claim._CLAIM_PORT, *domain_claim.DOMAINS = map(int, sys.argv[1:])
with domain_claim.claimed_domain() as domain:
    print(domain, flush=True)
    sys.stdin.read()
"""
JOIN = """import rclpy, sys
rclpy.init(args=[], domain_id=int(sys.argv[1]))
node = rclpy.create_node("stranger")
print("joined", flush=True)
sys.stdin.read()
"""


def started(code, *words):
    """A process, and the first line that it prints; it ends with its stdin."""
    pipe, line = subprocess.PIPE, [sys.executable, "-c", code, *map(str, words)]
    environment = {**os.environ, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    process = subprocess.Popen(line, stdin=pipe, stdout=pipe, text=True, env=environment)
    return process, process.stdout.readline().strip()


@pytest.fixture
def two(monkeypatch):
    """Two domains, kept from the rest of the machine, which are the only ones for this test."""
    with claimed_domain() as first, claimed_domain() as second:
        monkeypatch.setattr(domain_claim, "DOMAINS", (first, second))
        monkeypatch.setattr(domain_claim, "_CLAIM_PORT", PORT)
        yield {first, second}


def test_claims_at_once_are_of_different_domains():
    with ExitStack() as claims:
        own = [claims.enter_context(claimed_domain()) for _ in range(10)]
        others = []
        for _ in range(3):
            process, line = started(CLAIM)
            claims.callback(process.communicate)
            others.append(int(line))
        assert len({*own, *others}) == 13
        assert all(1 <= domain <= 101 for domain in (*own, *others))


def test_a_process_that_crashes_gives_its_domain_back(two):
    process, line = started(CLAIM, PORT, min(two))
    assert line == str(min(two))
    with claimed_domain() as left:
        assert left == max(two)
        os.kill(process.pid, signal.SIGKILL)
        process.communicate()
        with claimed_domain() as again:
            assert again == min(two)


def test_a_claim_ends_with_its_block_even_by_an_error(two):
    for _ in range(5):
        with pytest.raises(ZeroDivisionError), claimed_domain(), claimed_domain():
            _ = 1 // 0


def test_all_taken_is_an_error_that_says_so(two):
    with claimed_domain() as first, claimed_domain() as second:
        assert {first, second} == two
        with pytest.raises(NoDomainError, match=r"no DDS domain of \d+ to \d+ is free") as raised:
            claimed_domain().__enter__()
    assert raised.value.exit_code == FAILED


@pytest.mark.parametrize("participant", [0, 7, 119])
def test_a_domain_that_somebody_joined_without_a_claim_is_passed_over(two, participant):
    """Ports of DDSI-RTPS: 7400 + 250 domain + 10 + 2 participant."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.bind(("127.0.0.1", 7400 + 250 * min(two) + 10 + 2 * participant))
        for _ in range(2):
            with claimed_domain() as domain:
                assert domain == max(two)


def test_a_node_without_a_claim_is_seen(two):
    pytest.importorskip("rclpy")
    process, line = started(JOIN, min(two))
    assert line == "joined"
    try:
        for _ in range(2):
            with claimed_domain() as domain:
                assert domain == max(two)
    finally:
        process.communicate()
    with claimed_domain() as first, claimed_domain() as second:
        assert {first, second} == two
