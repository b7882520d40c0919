"""Independent references of demos/elastic_pendulum.py: the rigid pendulum, and Euler and Bernoulli's beam."""

from math import pi, sin, sinh, sqrt

import numpy as np
from scipy.special import ellipj, ellipk


def rigid_tip(t, height, g):
    """Tip (x, y) of a rigid rod of 1 m released from the horizontal: sin(theta / 2) = k sn(K - w t, k)."""
    w, k = sqrt(g / 2 / (1 / 3 + height**2 / 12)), sin(pi / 4)
    theta = 2 * np.arcsin(k * ellipj(ellipk(k**2) - w * t, k**2)[0])  # from the vertical
    return np.array([np.sin(theta), -np.cos(theta)])


class PinnedFreeBeam:
    """First bending mode of a slender rod of length 1 m, pinned at x = 0: tan(beta) = tanh(beta)."""

    beta, height = 3.92660231204792, 0.02

    def __init__(self, modulus, rho):
        self.omega = self.beta**2 * self.height * sqrt(modulus / 12 / rho)  # rad/s
        self.period = 2 * pi / self.omega

    def shape(self, X, amplitude=1e-4):
        """Displacement (d, n) of the mode: w(x) of the axis, cross sections stay normal to it."""
        beta, ratio = self.beta, sin(self.beta) / sinh(self.beta)
        w = amplitude * (np.sin(beta * X[0]) + ratio * np.sinh(beta * X[0]))
        slope = amplitude * beta * (np.cos(beta * X[0]) + ratio * np.cosh(beta * X[0]))
        return np.array([-X[1] * slope, w, 0 * w])[: len(X)]


def frequency(t, y):
    """Frequency (rad/s) of a vibration about 0, from its interpolated zeros."""
    i = np.flatnonzero(y[:-1] * y[1:] < 0)
    zeros = t[i] - y[i] * np.diff(t)[i] / np.diff(y)[i]
    return pi / np.diff(zeros).mean()
