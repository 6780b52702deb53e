"""Walkers as plain equations: what a return map asks of a motion, without the package's mechanics.

`rates(y)`, `guard(y)` and `reset(y)` of y = [q; v]; steps are those of DOP853 with a fixed length.
"""

import math

import numpy as np

from mbd_ros.core.events.event_location import sign_change
from mbd_ros.core.gait.flow import Segment
from mbd_ros.core.integration.dop853_tableau import DOP853
from mbd_ros.core.state import State
from mbd_ros.errors import FallError

_A = DOP853.a[: DOP853.stages + 1]


class PlainWalker:
    """A motion y' = rates(y) that jumps to reset(y) where guard(y) grows through zero."""

    longest = 12.0

    def __init__(self, rates, guard, reset, size, dt=0.2, may_strike=lambda y: True):
        self.rates, self.guard, self._reset = rates, guard, reset
        self.size, self._dt, self._may_strike = size, dt, may_strike

    def state(self, y, t=0.0):
        half = self.size // 2
        return State(t, np.array(y[:half], float), np.array(y[half:], float))

    def plus(self, x, d):
        half = self.size // 2
        return x._replace(q=x.q + d[:half], v=x.v + d[half:])

    def minus(self, x1, x0):
        return np.concatenate((x1.q - x0.q, x1.v - x0.v))

    def onto(self, x):
        return x

    def basis(self, x):
        return np.eye(self.size)

    def _step(self, y, h):
        k = []
        for row in _A[:-1]:
            k.append(
                np.array(self.rates(y + h * sum(a * r for a, r in zip(row, k, strict=False) if a)))
            )
        return y + h * np.array(_A[-1][: len(k)]).dot(k)

    def cycle(self, x):
        y, t, times = np.concatenate((x.q, x.v)), x.t, [x.t]
        while t < x.t + self.longest:
            after = self._step(y, self._dt)
            if not np.isfinite(after).all() or abs(after[0]) > math.pi:
                break
            h0, h1 = self.guard(y), self.guard(after)
            if len(times) > 1 and h0 < 0.0 <= h1 and self._may_strike(after):
                h = sign_change(
                    lambda h, y=y: self.guard(self._step(y, h)), (0.0, h0), (self._dt, h1)
                )
                end = self.state(self._step(y, h), t + h)
                times.append(t + h)
                segment = Segment(x, np.array(times), end, end, ("strike",))
                return (segment._replace(after=self.reset(segment, end)),)
            y, t = after, t + self._dt
            times.append(t)
        raise FallError(f"no strike within {t - x.t:g} s")

    def follow(self, segment, x):
        y = np.concatenate((x.q, x.v))
        for h in np.diff(segment.times):
            y = self._step(y, h)
        return self.state(y, x.t + segment.times[-1] - segment.times[0])

    def rate(self, x):
        return np.array(self.rates(np.concatenate((x.q, x.v))))

    def value(self, segment, x):
        return float(self.guard(np.concatenate((x.q, x.v))))

    def reset(self, segment, x):
        return self.state(self._reset(np.concatenate((x.q, x.v))), x.t)


def simplest_walker(slope, dt=0.2):
    """Garcia, Chatterjee, Ruina, Coleman, J. Biomech. Eng. 120, 1998, 281-288; y = th, phi, .."""

    def rates(y):
        th, phi, thd, phid = y.tolist()
        thdd = math.sin(th - slope)
        return (
            thd,
            phid,
            thdd,
            thdd + thd * thd * math.sin(phi) - math.cos(th - slope) * math.sin(phi),
        )

    def reset(y):
        th, _, thd, _ = y
        c = math.cos(2.0 * th)
        return -th, -2.0 * th, c * thd, c * (1.0 - c) * thd

    return PlainWalker(
        rates, lambda y: y[1] - 2.0 * y[0], reset, 4, dt, may_strike=lambda y: y[0] < 0.0
    )


def rimless_wheel(slope=0.08, alpha=math.pi / 8, gravity=9.81):
    """McGeer, Int. J. Robotics Research 9, 1990: the angle of the stance spoke, downhill."""
    cosine = math.cos(2.0 * alpha)
    return PlainWalker(
        lambda y: (y[1], gravity * math.sin(y[0])),
        lambda y: y[0] - slope - alpha,
        lambda y: (slope - alpha, cosine * y[1]),
        2,
        dt=0.05,
    )
