"""Walkers as plain equations: what a return map asks of a motion, without the package's mechanics.

`rates(y)`, `guard(y)` and `reset(y)` of y = [q; v]; steps are those of DOP853 with a fixed length.
"""

import math

import numpy as np

from mbd_ros.core.state import State
from mbd_ros.errors import FallError
from mbd_ros.methods.events.crossings import sign_change
from mbd_ros.methods.integration.dop853_tableau import DOP853
from mbd_ros.methods.sensitivities.flow import Segment

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

    def project(self, x):
        return x

    def basis(self, x):
        return np.eye(self.size)

    def is_timed(self, segment):
        return False

    def ends_phase(self, segment):
        return True

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


def round_foot_walker(slope=0.01, hip=1.0, leg=0.5, inertia=0.02, middle=0.5, radius=0.2):
    """A walker that rolls on round feet; legs of 1 m to the centres of the feet, gravity 1.

    y = a, b, a', b': stance and swing leg from the normal, positive where a leg leans downhill
    seen from its foot. The hip moves with ((cos a + r), -sin a) times -a' of the stance leg.
    """

    def places(a, b):
        """Jacobians of hip, stance and swing mass by (a', b'), and what their rates add."""
        hip_ = np.array([[-(math.cos(a) + radius), 0.0], [-math.sin(a), 0.0]])
        one, two = (np.array([middle * math.cos(s), middle * math.sin(s)]) for s in (a, b))
        return hip_, hip_ + np.outer(one, [1.0, 0.0]), hip_ + np.outer(two, [0.0, 1.0])

    masses = (hip, leg, leg)

    def rates(y):
        a, b, da, db = y.tolist()
        jacobians = places(a, b)
        hip_ = np.array([math.sin(a), -math.cos(a)]) * da * da
        one, two = (
            middle * np.array([-math.sin(s), math.cos(s)]) * ds * ds
            for s, ds in ((a, da), (b, db))
        )
        drifts = (hip_, hip_ + one, hip_ + two)
        weight = np.array([math.sin(slope), -math.cos(slope)])
        M, f = inertia * np.eye(2), np.zeros(2)
        for m, J, drift in zip(masses, jacobians, drifts, strict=True):
            M += m * J.T @ J
            f += m * J.T @ (weight - drift)
        return da, db, *np.linalg.solve(M, f)

    def reset(y):
        """Angular momentum about the new foot, and that of the old stance leg about the hip."""
        a, b, da, db = y
        before = [J @ (da, db) for J in places(a, b)]
        spins = inertia * da, inertia * db
        hip_, old, new = places(b, a)[0], places(b, a)[2], places(b, a)[1]
        at = np.array([-math.sin(b), math.cos(b) + radius])  # of the hip, from the new foot
        arms = [at, at + middle * np.array([math.sin(a), -math.cos(a)])]
        arms.append(at + middle * np.array([math.sin(b), -math.cos(b)]))

        def cross(arm, v):
            return arm[0] * v[1] - arm[1] * v[0]

        whole = sum(m * cross(arm, v) for m, arm, v in zip(masses, arms, before, strict=True))
        whole += sum(spins)
        own = leg * cross(arms[1] - arms[0], before[1]) + spins[0]
        M = np.zeros((2, 2))
        for i in range(2):
            unit = np.eye(2)[i]  # new stance rate, new swing rate
            after = [hip_ @ unit, old @ unit, new @ unit]
            M[0, i] = sum(m * cross(r, v) for m, r, v in zip(masses, arms, after, strict=True))
            M[0, i] += inertia
            M[1, i] = leg * cross(arms[1] - arms[0], after[1]) + inertia * unit[1]
        return b, a, *np.linalg.solve(M, [whole, own])

    return PlainWalker(
        rates, lambda y: -(y[0] + y[1]), reset, 4, 0.05, may_strike=lambda y: y[0] < -0.05
    )
