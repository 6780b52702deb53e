"""Hostile messages: bytes that are broken on the way, and well-formed messages of bad content."""

import math
import struct

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

NUMBERS = (0.0, -0.0, 5e-324, 1e-9, 1.0, -1.0, 3.0, 1e6, 1e150, 1e308, -1e308)
LOST = (math.nan, math.inf, -math.inf)
SECONDS = (0, 1, -1, 2**31 - 1, -(2**31), 1_700_000_000)
NANOSECONDS = (0, 1, 999_999_999, 1_000_000_000, 2**32 - 1)
COUNTS = (0, 1, 2, 3, 255, 10**6, 2**31 - 1, 2**31, 2**32 - 1)
TEXTS = ("", " ", "a", "nan", "../../etc", "x" * 5000, "\n\x1b[31m", "é\u202e", "a\x00b")


def broken(rng: np.random.Generator, cdr: bytes) -> bytes:
    """A serialized message, damaged."""
    damage = (_cut, _flipped, _counted, _stretched, _spliced, _noise, _headed)
    return damage[rng.integers(len(damage))](rng, bytearray(cdr))


def _cut(rng, cdr):
    """Not to nothing: DDS delivers no more of a reliable writer that sent an empty payload."""
    return bytes(cdr[: rng.integers(1, len(cdr))])


def _flipped(rng, cdr):
    for _ in range(1 + rng.integers(4)):
        cdr[rng.integers(4, len(cdr))] ^= 1 << int(rng.integers(8))
    return bytes(cdr)


def _counted(rng, cdr):
    at = 4 * int(rng.integers(1, max(2, len(cdr) // 4)))
    cdr[at : at + 4] = struct.pack("<I", COUNTS[rng.integers(len(COUNTS))])
    return bytes(cdr)


def _stretched(rng, cdr):
    return bytes(cdr) + rng.bytes(int(rng.integers(1, 2000)))


def _spliced(rng, cdr):
    begin, size = rng.integers(4, len(cdr)), rng.integers(1, 64)
    cdr[begin : begin + size] = rng.bytes(int(rng.integers(64)))
    return bytes(cdr)


def _noise(rng, cdr):
    return rng.bytes(int(rng.integers(1, 600)))


def _headed(rng, cdr):
    cdr[:4] = rng.bytes(4)
    return bytes(cdr)


class Hostile:
    """Makes well-formed messages whose content is bad, or only looks like it.

    Args:
        rng: Source of chance.
        joints: Names that the node knows.
        now: A stamp that the node accepts [ns].
    """

    def __init__(self, rng, joints, now):
        self._rng, self._joints, self._now = rng, list(joints), now

    def of(self, kind):
        """A message of a kind."""
        makers = {
            JointState: self._joint_state,
            Float64MultiArray: self._vector,
            JointTrajectory: self._trajectory,
            WrenchStamped: self._wrench,
            Clock: self._clock,
        }
        return makers[kind]()

    def cdr(self, kind):
        """Serialized bytes of such a message, every second time damaged."""
        cdr = serialize_message(self.of(kind))
        return broken(self._rng, cdr) if self._rng.integers(2) else cdr

    def _pick(self, choices):
        return choices[self._rng.integers(len(choices))]

    def _number(self):
        if self._rng.random() < 0.03:
            return self._pick(LOST)
        return self._pick(NUMBERS) if self._rng.random() < 0.3 else self._rng.normal()

    def _numbers(self, size):
        size = self._pick((0, 1, size + 1, 2 * size)) if self._rng.random() < 0.05 else size
        return [self._number() for _ in range(size)]

    def _names(self):
        names = list(self._joints)
        chance = self._rng.random()
        if chance < 0.05:
            names[self._rng.integers(len(names))] = self._pick(TEXTS)
        elif chance < 0.1:
            names = [*names, f"extra_{self._rng.integers(10**9)}"]
        elif chance < 0.15:
            names = names[: self._rng.integers(len(names) + 1)]
        elif chance < 0.2:
            names = names * 2
        elif chance < 0.3:
            self._rng.shuffle(names)
        return names

    def _stamp(self, stamp):
        chance = self._rng.random()
        if chance < 0.1:
            stamp.sec, stamp.nanosec = self._pick(SECONDS), self._pick(NANOSECONDS)
        else:
            late = int(self._rng.normal() * 10 ** self._rng.integers(6, 10))
            stamp.sec, stamp.nanosec = divmod(max(0, self._now + late), 10**9)
            stamp.nanosec = 2**32 - 1 if chance < 0.13 else stamp.nanosec

    def _joint_state(self):
        msg = JointState(name=self._names())
        self._stamp(msg.header.stamp)
        for field in ("position", "velocity", "effort"):
            if self._rng.random() < 0.9:
                setattr(msg, field, self._numbers(len(msg.name)))
        return msg

    def _vector(self):
        return Float64MultiArray(data=self._numbers(len(self._joints)))

    def _trajectory(self):
        msg = JointTrajectory(joint_names=self._names())
        self._stamp(msg.header.stamp)
        at = 0.0
        for _ in range(int(self._pick((0, 1, 2, 5, 30)))):
            point = JointTrajectoryPoint(positions=self._numbers(len(msg.joint_names)))
            at += abs(self._rng.normal())
            point.time_from_start.sec = (
                int(at) if self._rng.random() < 0.95 else self._pick(SECONDS)
            )
            point.time_from_start.nanosec = int(at % 1 * 1e9)
            for field in ("velocities", "accelerations", "effort"):
                if self._rng.random() < 0.5:
                    setattr(point, field, self._numbers(len(msg.joint_names)))
            msg.points.append(point)
        return msg

    def _wrench(self):
        msg = WrenchStamped()
        self._stamp(msg.header.stamp)
        msg.header.frame_id = self._pick(("", "world", *TEXTS))
        for vector in (msg.wrench.force, msg.wrench.torque):
            vector.x, vector.y, vector.z = (self._number() for _ in range(3))
        return msg

    def _clock(self):
        msg = Clock()
        self._stamp(msg.clock)
        return msg
