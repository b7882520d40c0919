"""The slider crank with an elastic connecting rod of the IVP test set, as one body with its own equations.

Coordinates (phi1, phi2, x3, q1, q2, q3, q4): crank and rod angle (rad), slider position (m), two lateral sine modes, axial
displacement of the rod's middle and end (quadratic ansatz), m; all in the frame of the rod's undeformed axis. The functions
take one configuration, y (7,), or many side by side, y (7, k).

Source: B. Simeon, "Modelling a flexible slider crank mechanism by a mixed system of DAEs and PDEs",
Mathematical Modelling of Systems 2 (1996) 1-18, doi:10.1080/13873959608837026.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

import fmbd_fenicsx as fmbd

PI = 3.1415927  # as printed in the test set
M1, M2, M3, L1, L2, J1, J2 = 0.36, 0.151104, 0.075552, 0.15, 0.30, 0.002727, 0.0045339259
E, NU, B, H, RHO, OMEGA = 2.0e11, 0.3, 0.008, 0.008, 7870.0, 150.0
F = B * H * L2


# Starts: coordinates and rates, (14,). The printed x3 leaves the slider 2.03e-10 m off the rod's end; it is put there, which
# leaves the elastic coordinates as printed. The rates are projected in the mass metric by fmbd.solve (they are 1.2e-8 m/s off).
SMOOTH = np.zeros(14)
SMOOTH[[2, 5, 6]] = L1 + L2 + 1.69327969e-05, 1.03339863e-05, 1.69327969e-05
SMOOTH[7:] = 150.0, -74.995767, -2.68938672e-06, 0.444896105, 0.00463434311, -1.78591076e-06, -2.68938672e-06
RIGID = np.zeros(14)
RIGID[[2, 7, 8]] = L1 + L2, 150.0, -75.0
STARTS = {"smooth": SMOOTH, "rigid": RIGID}


@dataclass(frozen=True)
class Rod:
    """Variants: ``consistent_mass`` scales the printed axial mass block by 1/15; ``nonlinear`` adds (EA/2) int u' w'^2.

    ``height`` (m) of the section.
    """

    consistent_mass: bool = False
    nonlinear: bool = False
    damped: bool = False
    height: float = H

    @cached_property
    def density(self) -> float:
        """RHO for the printed height: the shape integrals below hold for it, kg/m^3."""
        return RHO * self.height / H

    @cached_property
    def inertia(self) -> tuple[float, float]:
        """Mass (kg) and moment of inertia about the crank pin (kg m^2)."""
        return (M2, J2) if self.height == H else (self.density * F, self.density * F * (L2**2 + self.height**2 / 4) / 3)

    @cached_property
    def mass(self) -> np.ndarray:
        """M_q, kg."""
        out = 0.5 * np.eye(4)
        out[2:, 2:] = np.array([[8.0, 1.0], [1.0, 2.0]]) * (1 / 15 if self.consistent_mass else 1.0)
        return self.density * F * out

    @cached_property
    def stiffness(self) -> np.ndarray:
        """K_q, N/m."""
        out = np.diag([PI**4 / 24 * (self.height / L2) ** 2, PI**4 * 2 / 3 * (self.height / L2) ** 2, 0.0, 0.0])
        out[2:, 2:] = [[16 / 3, -8 / 3], [-8 / 3, 7 / 3]]
        return E * B * self.height / L2 * out

    @cached_property
    def damping(self) -> np.ndarray:
        """D_q, N s/m: about 0.5 per cent."""
        out = np.diag([5.0, 25.0, 0.0, 0.0])
        out[2:, 2:] = [[115.41877276323955, -131.3442439960265], [-131.3442439960263, 210.8710918578409]]
        return out if self.damped else 0.0 * out


# References: at the end; frequencies (rad/s) with printed and consistent axial mass
ENDS = {  # end (s), consistent, nonlinear: phi2, q1..q4, lambda, and to what share q and lambda are known
    (0.01, False, False): (-5.2216396918854e-01, [8.31920513008e-4, 4.7387526529218e-5, -3.4977307824339e-6, -5.6622714711243e-6],
                           [-35.892818883497, -127.38311391763, 38.637431826448], 1e-5),
    (0.1, False, False): (-0.331173498825626, [1.893192899613509e-4, 2.375751249879174e-5, -5.323896770569702e-6,
                          -8.363313279112129e-6], [-62.32935833287916, -163.7920993367306, 25.29857947066878], 1e-8),
    (0.1, True, False): (-0.331173430332826, [1.893081681938e-4, 2.376201085077e-5, -5.281024759897e-6, -8.303554444834e-6],
                         [-62.20521365688933, -163.46412923635248, 24.97218490190467], 1e-7),
    (0.1, False, True): (-0.33117388762831856, [-1.180767246912e-4, 2.365146392725e-5, -5.475025837718e-6, -8.702536690209e-6],
                         [-87.39734041071817, -163.55290066837492, 29.319751697448616], 1e-7),
}  # fmt: skip
FREQUENCIES = {
    False: [1276.6864363, 5106.74574521, 6840.81686358, 24612.65840743],
    True: [1276.6864363, 5106.74574521, 26494.36978712, 95324.41611789],
}


# shape integrals: of u, v, x u, x v, and of u_i v_j - v_i u_j over the rod
C1, C2 = F * np.array([0, 0, 2 / 3, 1 / 6]), F * np.array([2 / PI, 0, 0, 0])
C12, C21 = L2 * F * np.array([0, 0, 1 / 3, 1 / 6]), L2 * F * np.array([1 / PI, -1 / (2 * PI), 0, 0])
BQ = np.zeros((4, 4))
BQ[0, 2], BQ[0, 3], BQ[1, 3] = -16 / PI**3, 8 / PI**3 - 1 / PI, 1 / (2 * PI)
BQ = F * (BQ - BQ.T)


def mass_matrix(rod: Rod, y: np.ndarray) -> np.ndarray:
    """M(y), (7, 7)."""
    s, c, q, Mq = np.sin(y[0] - y[1]), np.cos(y[0] - y[1]), y[3:], rod.mass
    (m2, j2), rho = rod.inertia, rod.density
    M = np.zeros((7, 7, *y.shape[1:]), dtype=y.dtype)
    M[0, 0] = J1 + m2 * L1**2
    M[0, 1] = M[1, 0] = 0.5 * L1 * L2 * m2 * c + rho * L1 * (s * (C2 @ q) + c * (C1 @ q))
    M[1, 1], M[2, 2] = j2 + (q * (Mq @ q)).sum(0) + 2 * rho * (C12 @ q), M3
    M[0, 3:] = M[3:, 0] = rho * L1 * (np.multiply.outer(C2, c) - np.multiply.outer(C1, s))
    M[1, 3:] = M[3:, 1] = rho * (_column(C21, y) + BQ.T @ q)
    M[3:, 3:] = _column(Mq, y)
    return M


def forces(rod: Rod, y: np.ndarray, v: np.ndarray) -> np.ndarray:
    """f(y, y'), (7,): velocity terms, elastic and damping forces."""
    s, c, q, w1, w2, qd = np.sin(y[0] - y[1]), np.cos(y[0] - y[1]), y[3:], v[0], v[1], v[3:]
    m2, rho = rod.inertia[0], rod.density
    c1, c2, c1d, c2d, Mq = C1 @ q, C2 @ q, C1 @ qd, C2 @ qd, rod.mass @ q
    spin, Bqd = w2**2, BQ @ qd
    f = np.zeros(y.shape, dtype=np.result_type(y, v))
    f[0] = -0.5 * L1 * L2 * m2 * spin * s + rho * L1 * w2 * (w2 * (-s * c1 + c * c2) - 2 * (c * c1d + s * c2d))
    f[1] = 0.5 * L1 * L2 * m2 * w1**2 * s + rho * L1 * w1**2 * (s * c1 - c * c2)
    f[1] -= 2 * rho * w2 * (C12 @ qd) + 2 * w2 * (qd * Mq).sum(0) + rho * (qd * Bqd).sum(0)
    push = np.multiply.outer(C1, c) + np.multiply.outer(C2, s)
    f[3:] = spin * Mq + rho * (np.multiply.outer(C12, spin) + L1 * w1**2 * push + 2 * w2 * Bqd)
    f[3:] -= rod.stiffness @ q
    if rod.damped:
        f[3:] -= rod.damping @ qd
    if rod.nonlinear:
        kappa, beta, d = E * B * rod.height * PI**2 / (2 * L2**2), 80 / (9 * PI**2), 2 * q[3] - 4 * q[2]
        f[3] -= kappa * (q[0] * q[3] - beta * q[1] * d)
        f[4] -= kappa * (4 * q[1] * q[3] - beta * q[0] * d)
        f[5] -= 4 * kappa * beta * q[0] * q[1]
        f[6] -= kappa * (q[0] ** 2 / 2 + 2 * q[1] ** 2 - 2 * beta * q[0] * q[1])
    return f


Motion = Callable[[float], tuple[float, float, float]]


def steady(t: float) -> tuple[float, float, float]:
    """Crank angle OMEGA t (rad) and its first and second rate."""
    return OMEGA * t, OMEGA, 0.0


def _driven(motion: Motion, t: float) -> np.ndarray:
    """Angle and rates at one time, (3,), or at many, (3, k)."""
    return np.array(motion(t) if np.ndim(t) == 0 else np.transpose([motion(x) for x in t]))


def _column(A: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A constant with a last axis for each configuration in y."""
    return A.reshape(*A.shape, *(1,) * (y.ndim - 1))


def constraints(y: np.ndarray, t: float, motion: Motion = steady) -> np.ndarray:
    """Rod end on the slide, slider at the rod end, crank angle as prescribed."""
    reach = L2 + y[6]
    across = L1 * np.sin(y[0]) + reach * np.sin(y[1])
    along = y[2] - L1 * np.cos(y[0]) - reach * np.cos(y[1])
    return np.array([across, along, y[0] - _driven(motion, t)[0]])


def jacobian(y: np.ndarray, t: float) -> np.ndarray:
    """dg/dy, (3, 7)."""
    reach, (s1, c1), (s2, c2) = L2 + y[6], (np.sin(y[0]), np.cos(y[0])), (np.sin(y[1]), np.cos(y[1]))
    G = np.zeros((3, 7, *y.shape[1:]))
    G[0, 0], G[0, 1], G[0, 6] = L1 * c1, reach * c2, s2
    G[1, 0], G[1, 1], G[1, 2], G[1, 6] = L1 * s1, reach * s2, 1.0, -c2
    G[2, 0] = 1.0
    return G


def rate(y: np.ndarray, t: float, motion: Motion = steady) -> np.ndarray:
    """dg/dt, (3,)."""
    zero = 0.0 * y[0]
    return np.array([zero, zero, zero - _driven(motion, t)[1]])


def gamma(y: np.ndarray, v: np.ndarray, t: float, motion: Motion = steady) -> np.ndarray:
    """The part of g'' without y'', (3,)."""
    reach, (s1, c1), (s2, c2) = L2 + y[6], (np.sin(y[0]), np.cos(y[0])), (np.sin(y[1]), np.cos(y[1]))
    across = -L1 * s1 * v[0] ** 2 - reach * s2 * v[1] ** 2 + 2 * v[6] * c2 * v[1]
    along = L1 * c1 * v[0] ** 2 + reach * c2 * v[1] ** 2 + 2 * v[6] * s2 * v[1]
    return np.array([across, along, 0.0 * across - _driven(motion, t)[2]])


def scene(rod: Rod, start: np.ndarray) -> fmbd.Scene:
    """The crank alone, with sensors "coordinates" and "multipliers"."""
    made = fmbd.Scene("slider crank")
    body = crank(rod, start)
    made.add(body)
    made.sensor(
        "coordinates", fmbd.coordinates(body, unit="m, rad", names=("phi1", "phi2", "x3", "q1", "q2", "q3", "q4"))
    )
    made.sensor("multipliers", fmbd.reaction("crank"))
    return made


def crank(rod: Rod, start: np.ndarray, motion: Motion = steady) -> fmbd.CoordinateBody:
    """The mechanism; ``start`` holds the seven coordinates and their rates, ``motion`` drives the crank."""
    return fmbd.CoordinateBody(
        "crank",
        lambda y: mass_matrix(rod, y),
        lambda y, v, t: forces(rod, y, v),
        start[:7],
        start[7:14],
        lambda y, t: constraints(y, t, motion),
        jacobian,
        lambda y, v, t: gamma(y, v, t, motion),
        rate=lambda y, t: rate(y, t, motion),
        vectorized=True,
        outline=outline,
    )


def outline(y: np.ndarray) -> list[np.ndarray]:
    """Crank, rod with its bending, slider: lines in the world, m."""
    pin = L1 * np.array([np.cos(y[0]), np.sin(y[0])])
    x = np.linspace(0.0, 1.0, 25)
    v = y[3] * np.sin(PI * x) + y[4] * np.sin(2 * PI * x)
    along, across = np.array([np.cos(y[1]), np.sin(y[1])]), np.array([-np.sin(y[1]), np.cos(y[1])])
    rod = pin + L2 * x[:, None] * along + v[:, None] * across

    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (-1, -1)])
    return [np.array([(0.0, 0.0), pin]), rod, np.array([y[2], 0.0]) + corners * (0.02, 0.012)]
