"""The planar truck in its nine coordinates: forces by virtual work from the springs' lengths, integrated by DOP853.

p = (y rear wheel, y chassis, phi chassis, y front wheel, y cab, phi cab, x load, y load, phi load). With the pin, x and y of the
load follow from phi chassis, y chassis and phi load. Lengths and their gradients are differentiated by complex steps, so that no
force or moment is written by hand.
"""

from __future__ import annotations

import numpy as np
from numpy import cos, sin
from scipy.integrate import solve_ivp

M = np.array([1450.0, 3335.0, 14313.0, 600.0, 1100.0, 948.0, 11515.0, 11515.0, 33000.0])
START = np.array([0.5, 2.0, 0.0, 0.5, 2.9, 0.0, -1.46, 2.9, 0.0])
A12, A23, A24, A42, A25, A52, B42, B24 = -2.06, 2.44, 1.94, 3.64, 0.98, -3.07, 0.9, -0.8
C25, C1D, C2D, AC, CC, H1, G = 2.44, -1.91, -1.31, (-3.07, 0.15), (-1.61, -0.75), -1.34, 9.81
K = np.array([4.4e6, 2.2e6, 824700.0, 271100.0, 135700.0, 135700.0, 9e5, 7.7e5, 7.7e5])
D = np.array([600.0, 300.0, 21593.0, 38537.0, 12218.0, 12218.0, 38500.0, 33013.0, 33013.0])
F = -np.array([2329145.162, 1147434.838, 246872.662, 84924.838, 127842.88235294, 127208.11764706, 854905.94111111,
               766354.91099974, 766354.91099974])  # fmt: skip


def hump(t):
    """Road under the rear and the front wheel."""
    s = t - 2 / 15 - np.array([(A23 - A12) / 15, 0.0])
    return np.where(np.real(s) < 0, 0.0, 0.001 * s**6 * np.exp(-s))


def lengths(p, t):
    """Lengths of the nine springs, (9,)."""
    y1, y2, f2, y3, y4, f4, x5, y5, f5 = p

    def chassis(x, y):
        return x * cos(f2) - y * sin(f2), y2 + x * sin(f2) + y * cos(f2)

    def cab(x):
        return A24 - B24 + x * cos(f4), y4 + x * sin(f4)

    def load(x):
        return x5 + x * cos(f5), y5 + x * sin(f5)

    u1, u3 = hump(t)
    pairs = [((A12, u1), (A12, y1)), ((A23, u3), (A23, y3))]
    pairs += [((A12, y1), chassis(A12, H1)), ((A23, y3), chassis(A23, H1))]
    pairs += [(chassis(A24, 0), cab(B24)), (chassis(A42, 0), cab(B42)), (chassis(A25, 0), load(C25))]
    pairs += [(chassis(A52, 0), load(C1D)), (chassis(A52, 0), load(C2D))]
    return np.array([np.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2) for a, b in pairs])


def force(p, v, t, pinned):
    """Q(p, v, t), (9,): -sum N dl/dp and weights."""
    n = 7 if pinned else 9
    step = 1e-30
    B = np.array([lengths(p + 1j * step * e, t).imag / step for e in np.eye(9)]).T[:n]
    rate = B @ v + lengths(p.astype(complex), t + 1j * step)[:n].imag / step
    N = K[:n] * lengths(p, t)[:n] + D[:n] * rate + F[:n]
    Q = -B.T @ N
    Q[[0, 1, 3, 4, 7]] -= G * M[[0, 1, 3, 4, 7]]
    return Q


def pinned_coordinates(z, zd):
    """p, v, T = dp/dz and T' z' for z = (y1, y2, f2, y3, y4, f4, f5)."""
    (y1, y2, f2, y3, y4, f4, f5), w2, w5 = z, zd[2], zd[6]

    def turned(a, f):
        return np.array([a[0] * cos(f) - a[1] * sin(f), a[0] * sin(f) + a[1] * cos(f)])

    a, c = turned(AC, f2), turned(CC, f5)
    x = np.array([0.0, y2]) + a - c
    p = np.array([y1, y2, f2, y3, y4, f4, *x, f5])
    T = np.zeros((9, 7))
    T[[0, 1, 2, 3, 4, 5, 8], range(7)] = 1.0
    T[7, 1] = 1.0
    T[6:8, 2], T[6:8, 6] = (-a[1], a[0]), (c[1], -c[0])
    bias = np.zeros(9)
    bias[6:8] = -a * w2**2 + c * w5**2
    return p, T @ zd, T, bias


def solve(t_end, times, pinned, tolerance=1e-12):
    """p at the given times, (n, 9)."""
    pick = [0, 1, 2, 3, 4, 5, 8] if pinned else list(range(9))

    def rhs(t, y):
        n = len(pick)
        if not pinned:
            return np.concatenate((y[n:], force(y[:n], y[n:], t, False) / M))
        p, v, T, bias = pinned_coordinates(y[:n], y[n:])
        Q = T.T @ (force(p, v, t, True) - M * bias)
        return np.concatenate((y[n:], np.linalg.solve(T.T @ (M[:, None] * T), Q)))

    y, out, t = np.concatenate((START[pick], np.zeros(len(pick)))), [], 0.0
    for stop in sorted({2 / 15, 2 / 15 + (A23 - A12) / 15, *times}):  # where the road is not smooth
        if stop > t:
            y = solve_ivp(rhs, (t, stop), y, method="DOP853", rtol=tolerance, atol=1e-13).y[:, -1]
            t = stop
        if stop in times:
            n = len(pick)
            out.append(pinned_coordinates(y[:n], y[n:])[0] if pinned else y[:n])
    return np.array(out)


if __name__ == "__main__":
    for pinned in (True, False):
        print(repr(solve(10.0, [1.0, 2.0, 5.0, 10.0], pinned).tolist()))
