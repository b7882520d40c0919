"""Andrews' squeezing mechanism: seven angles, six loop equations, data and reference of the IVP test set.

Mechanism as in Hairer and Wanner, Solving ODEs II, section VII.7 (doi:10.1007/978-3-642-05221-7). Reference: the positions at
t = 0.03 s of the test set and of an own state-space run (DOP853).
"""

import numpy as np
from numpy import cos, sin

import fmbd_fenicsx as fmbd

M1, M2, M3, M4, M5, M6, M7 = 0.04325, 0.00365, 0.02373, 0.00706, 0.0705, 0.00706, 0.05498  # kg
I1, I2, I3, I4, I5, I6, I7 = 2.194e-6, 4.41e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5  # kg m^2
XA, YA, XB, YB, XC, YC = -0.06934, -0.00227, -0.03635, 0.03273, 0.014, 0.072  # m, fixed points
C0, L0, TORQUE = 4530.0, 0.07785, 0.033  # N/m, m, N m
D, DA, E, EA, RR, RA, SS, SA, SB, SC, SD = (
    0.028,
    0.0115,
    0.02,
    0.01421,
    0.007,
    0.00092,
    0.035,
    0.01874,
    0.01043,
    0.018,
    0.02,
)
TA, TB, U, UA, UB, ZF, ZT, FA = 0.02308, 0.00916, 0.04, 0.01228, 0.00449, 0.02, 0.04, 0.01421
START = [-0.06171389001427645, 0.0, 0.45527981916307037, 0.22266839016588588, 0.48736497954384256, -0.22266839016588588,
         1.2305474445498212]  # fmt: skip
REFERENCE = np.array([15.810771195153752, -15.756371058411908, 0.040822240119638725, -0.5347301163420906, 0.52440996587995,
                      0.5347301163420937, 1.0480807410419477])  # fmt: skip


def mass(q):
    """M(q), (7, 7)."""
    _, th, _, ph, _, om, _ = q
    M, e, z = np.zeros((7, 7, *q.shape[1:]), dtype=q.dtype), E - EA, ZF - FA
    M[0, 0] = M1 * RA**2 + M2 * (RR**2 - 2 * DA * RR * cos(th) + DA**2) + I1 + I2
    M[1, 0] = M[0, 1] = M2 * (DA**2 - DA * RR * cos(th)) + I2
    M[1, 1] = M2 * DA**2 + I2
    M[2, 2] = M3 * (SA**2 + SB**2) + I3
    M[3, 3] = M4 * e**2 + I4
    M[4, 3] = M[3, 4] = M4 * (e**2 + ZT * e * sin(ph)) + I4
    M[4, 4] = M4 * (ZT**2 + 2 * ZT * e * sin(ph) + e**2) + M5 * (TA**2 + TB**2) + I4 + I5
    M[5, 5] = M6 * z**2 + I6
    M[6, 5] = M[5, 6] = M6 * (z**2 - U * z * sin(om)) + I6
    M[6, 6] = M6 * (z**2 - 2 * U * z * sin(om) + U**2) + M7 * (UA**2 + UB**2) + I6 + I7
    return M


def force(q, v, t):
    """f(q, q'), (7,): torque, spring, and the terms of the rates that the angles leave."""
    _, th, ga, ph, _, om, _ = q
    be_, th_, _, ph_, de_, om_, ep_ = v
    dx, dy = SD * cos(ga) + SC * sin(ga) + XB - XC, SD * sin(ga) - SC * cos(ga) + YB - YC
    length = np.sqrt(dx**2 + dy**2)
    pull = -C0 * (length - L0) / length
    return np.array([
        TORQUE - M2 * DA * RR * th_ * (th_ + 2 * be_) * sin(th),
        M2 * DA * RR * be_**2 * sin(th),
        pull * dx * (SC * cos(ga) - SD * sin(ga)) + pull * dy * (SD * cos(ga) + SC * sin(ga)),
        M4 * ZT * (E - EA) * de_**2 * cos(ph),
        -M4 * ZT * (E - EA) * ph_ * (ph_ + 2 * de_) * cos(ph),
        -M6 * U * (ZF - FA) * ep_**2 * cos(om),
        M6 * U * (ZF - FA) * om_ * (om_ + 2 * ep_) * cos(om),
    ])  # fmt: skip


def constraint(q, t):
    """The three loops that meet in one point, (6,)."""
    be, th, ga, ph, de, om, ep = q
    x, y = RR * cos(be) - D * cos(be + th), RR * sin(be) - D * sin(be + th)
    return np.array([
        x - SS * sin(ga) - XB, y + SS * cos(ga) - YB,
        x - E * sin(ph + de) - ZT * cos(de) - XA, y + E * cos(ph + de) - ZT * sin(de) - YA,
        x - ZF * cos(om + ep) - U * sin(ep) - XA, y - ZF * sin(om + ep) + U * cos(ep) - YA,
    ])  # fmt: skip


def outline(q):
    """The seven bodies and the spring as lines in the plane, for pictures."""
    be, th, ga, ph, de, om, ep = q
    a, b, c = np.array([XA, YA]), np.array([XB, YB]), np.array([XC, YC])
    ray = lambda angle: np.array([cos(angle), sin(angle)])
    crank = RR * ray(be)
    meet = crank - D * ray(be + th)
    hook = b + SC * ray(ga - np.pi / 2) + SD * ray(ga)

    lines = ((0 * a, crank), (crank, meet), (b, meet, hook, b), (hook, c))
    lines += ((a, a + ZT * ray(de), meet), (a, a + U * ray(ep - np.pi / 2), meet))
    return [np.array(line) for line in lines]


def scene():
    """The mechanism at rest."""
    made = fmbd.Scene("Andrews' mechanism")
    squeezer = fmbd.CoordinateBody(
        "squeezer", mass, force, START, constraint=constraint, vectorized=True, outline=outline
    )
    made.add(squeezer)
    made.sensor(
        "angles",
        fmbd.coordinates("squeezer", unit="rad", names=("beta", "Theta", "gamma", "Phi", "delta", "Omega", "epsilon")),
    )
    return made
