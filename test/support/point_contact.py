"""Cases that several tests share: point contact."""

import numpy as np

GRAVITY = 9.81


def block(t, degrees, mu, v):
    """Closed form of the way uphill: it decelerates, then sticks or slides back."""
    s, c = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    way = np.sign(v) or -1.0
    a = -GRAVITY * (s + way * mu * c)
    stop = -v / a if v and -v / a > 0.0 else (0.0 if not v else np.inf)
    top = v * min(stop, 1e300) / 2.0 if stop < np.inf else 0.0
    back = -GRAVITY * max(s - mu * c, 0.0)
    late = np.maximum(t - stop, 0.0)
    return np.where(t < stop, v * t + 0.5 * a * t * t, top + 0.5 * back * late**2)
