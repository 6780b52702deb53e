"""Hostile messages: bytes that are broken on the way, and well-formed messages of bad content."""

import math
import struct

import numpy as np
from builtin_interfaces.msg import Duration, Time
from lifecycle_msgs.srv import ChangeState
from rclpy.serialization import deserialize_message, serialize_message

NUMBERS = (0.0, -0.0, 5e-324, 1e-9, 1.0, -1.0, 3.0, 1e6, 1e150, 1e308, -1e308)
LOST = (math.nan, math.inf, -math.inf)
SECONDS = (0, 1, -1, 2**31 - 1, -(2**31), 1_700_000_000)
NANOSECONDS = (0, 1, 999_999_999, 1_000_000_000, 2**32 - 1)
COUNTS = (0, 1, 2, 3, 255, 10**6, 2**31 - 1, 2**31, 2**32 - 1)
TEXTS = ("", " ", "a", "nan", "../../etc", "x" * 5000, "\n\x1b[31m", "é\u202e", "a\x00b")
LARGE = 0.05  # of the messages that are stretched, up to 1 MiB
BADNESS = (
    0.0,
    0.0,
    0.0,
    0.0,
    0.02,
    0.1,
    0.5,
)  # chance of a field to be bad, one of them a message
STEP = 5_000_000  # ns by which the time of messages goes on
SHARED = 4  # messages of one time: parts of a sample go by their stamps


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
    if rng.random() < LARGE:
        return bytes(cdr) + bytes(int(rng.integers(2**20)))
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
    """Makes messages whose content is bad, or only looks like it, of valid ones.

    Args:
        rng: Source of chance.
        now: A stamp that the node accepts [ns]; time goes on from it.
    """

    def __init__(self, rng, now):
        self._rng, self.now, self._made = rng, now, 0

    def cdr(self, seed):
        """Serialized bytes of a valid message made bad, every third time damaged."""
        cdr = serialize_message(self.of(seed))
        return cdr if self._rng.integers(3) else broken(self._rng, cdr)

    def of(self, seed):
        """A message like a valid one; about half of them have bad fields."""
        msg = deserialize_message(serialize_message(seed), type(seed))
        self._made += 1
        if self._made % SHARED == 0:
            self.now += STEP
        self._spoil(msg, self._pick(BADNESS))
        return msg

    def request(self, kind, names):
        """A request of a service.

        Args:
            names: Texts that the node knows, such as those of its parameters.
        """
        request = kind.Request()
        if kind is ChangeState:  # transitions that there are would be no bad input
            request.transition.id = self._pick((0, 99, 200, 255))
            request.transition.label = self._pick(TEXTS[1:])
            return request
        for field, of_type in request.get_fields_and_field_types().items():
            if of_type == "boolean":
                setattr(request, field, bool(self._rng.integers(2)))
            elif of_type == "sequence<string>":
                setattr(request, field, [self._pick((*names, *TEXTS)) for _ in range(3)])
            elif of_type == "sequence<rcl_interfaces/Parameter>":
                setattr(request, field, [self._parameter(self._pick(names))])
            else:
                self._spoil_field(request, field, of_type, 0.5)
        return request

    def _parameter(self, name):
        from rcl_interfaces.msg import Parameter

        parameter = Parameter(name=name)
        value = parameter.value
        value.type = int(self._pick((0, 1, 2, 3, 3, 3, 4, 5, 6, 7, 8, 8, 9, 10, 200)))
        value.bool_value = bool(self._rng.integers(2))
        value.integer_value = self._pick((0, 1, -1, 2, 1000, 2**62, -(2**63)))
        value.double_value = self._number()
        value.string_value = self._pick(TEXTS)
        size = self._pick((0, 1, 2, 3, 100))
        value.double_array_value = [self._number() for _ in range(size)]
        value.integer_array_value = [1] * size
        value.bool_array_value = [True] * size
        value.byte_array_value = [b"a"] * size
        value.string_array_value = [self._pick(TEXTS) for _ in range(size)]
        return parameter

    def _pick(self, choices):
        return choices[self._rng.integers(len(choices))]

    def _number(self):
        if self._rng.random() < 0.1:
            return self._pick(LOST)
        return self._pick(NUMBERS) if self._rng.random() < 0.3 else float(self._rng.normal())

    def _spoil(self, msg, badness):
        for field, of_type in msg.get_fields_and_field_types().items():
            self._spoil_field(msg, field, of_type, badness)

    def _spoil_field(self, msg, field, of_type, badness):
        value = getattr(msg, field)
        if isinstance(value, Time):
            self._stamp(value)
        elif isinstance(value, Duration):
            if self._rng.random() < badness:
                value.sec, value.nanosec = self._pick(SECONDS), self._pick(NANOSECONDS)
        elif hasattr(value, "get_fields_and_field_types"):
            self._spoil(value, badness)
        elif of_type == "sequence<double>":
            setattr(msg, field, self._doubles(list(value), badness))
        elif of_type == "sequence<string>":
            setattr(msg, field, self._texts(list(value), badness))
        elif of_type.startswith("sequence<"):
            setattr(msg, field, self._parts(list(value), badness))
        elif self._rng.random() < badness:
            self._spoil_leaf(msg, field, of_type)

    def _spoil_leaf(self, msg, field, of_type):
        if of_type == "string":
            setattr(msg, field, self._pick(TEXTS))
        elif of_type == "boolean":
            setattr(msg, field, bool(self._rng.integers(2)))
        elif of_type == "double":
            setattr(msg, field, self._number())
        elif of_type == "float":
            setattr(msg, field, self._pick((0.0, 1.0, -1.0, *LOST)))
        elif of_type.startswith("double["):
            setattr(msg, field, [self._number() for _ in getattr(msg, field)])
        elif "int" in of_type and "[" not in of_type:
            bits = int(of_type.removeprefix("u").removeprefix("int"))
            low = 0 if of_type.startswith("u") else -(2 ** (bits - 1))
            high = low + 2**bits - 1
            setattr(msg, field, self._pick((low, high, 0, 1, 2, 3)))

    def _doubles(self, values, badness):
        if self._rng.random() < 0.3 * badness:
            size = self._pick((0, 1, len(values) + 1, 2 * len(values)))
            values = (values * 2 + [0.0])[:size]
        bad = np.flatnonzero(self._rng.random(len(values)) < badness)
        for i in bad.tolist():
            values[i] = self._number()
        return values

    def _texts(self, names, badness):
        if not names or self._rng.random() > badness:
            return names
        chance = self._rng.integers(5)
        if chance == 0:
            names[self._rng.integers(len(names))] = self._pick(TEXTS)
        elif chance == 1:
            names.append(f"extra_{self._rng.integers(10**9)}")
        elif chance == 2:
            names = names[: self._rng.integers(len(names) + 1)]
        elif chance == 3:
            names = names * 2
        else:
            self._rng.shuffle(names)
        return names

    def _parts(self, parts, badness):
        if parts and hasattr(parts[0], "get_fields_and_field_types"):
            for part in parts:
                self._spoil(part, badness)
        if parts and self._rng.random() < badness:
            parts = self._pick((parts[:-1], parts * 2, parts[::-1], []))
        return parts

    def _stamp(self, stamp):
        """Mostly the present; else a moment ago, long ago, to come, none, or no time at all."""
        chance = self._rng.random()
        if chance < 0.04:
            stamp.sec, stamp.nanosec = self._pick(SECONDS), self._pick(NANOSECONDS)
            return
        off = 0
        if chance < 0.1:
            off = int(self._rng.normal() * 10 ** self._rng.integers(6, 10))
        elif chance < 0.25:
            off = -int(self._rng.integers(3 * 10**8))
        stamp.sec, stamp.nanosec = divmod(max(0, self.now + off), 10**9)
