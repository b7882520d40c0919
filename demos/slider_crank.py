"""Slider crank with an elastic connecting rod: the problem of the IVP test set, solved in its GGL form.

Run:  ./with-dolfinx python3 demos/slider_crank.py [--rod modes | elements] [--fast] [--json FILE] [--picture FILE]

Seven coordinates (demos/crank_model.py), three constraints, the crank driven at 150 rad/s, 0.1 s. The rod's axial mass is the one
that the test set prints; --fast ends at 0.01 s. References: modal frequencies recomputed from the printed matrices; the
state at 0.1 s of the test set's revision of 2006; at 0.01 s an own run without constraints (order 8, 1e-13).
--rod elements: the same crank with a rod of finite elements, demos/slider_crank_fe.py.
"""

import sys

import crank_model as model
import numpy as np
import slider_crank_fe
from scipy.linalg import eigh

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.faces.demo import Check, arguments, finish, say

args = arguments(__doc__, {"--rod": ("modes", "elements"), **slider_crank_fe.OWN})
if args.rod == "elements":
    sys.exit(slider_crank_fe.main(args))
t_end, rtol = (0.01, 1e-6) if args.fast else (0.1, 1e-8)
START = np.zeros(14)
START[[2, 5, 6]] = 0.450016933, 1.03339863e-05, 1.69327969e-05
START[7:] = 150.0, -74.995767, -2.68938672e-06, 0.444896105, 0.00463434311, -1.78591076e-06, -2.68938672e-06
END = {  # phi2, q1..q4, lambda
    0.01: (-5.2216396918854e-01, [8.31920513008e-04, 4.7387526529218e-05, -3.4977307824339e-06, -5.6622714711243e-06],
           [-35.892818883497, -127.38311391763, 38.637431826448]),
    0.1: (-0.331173498825626, [1.893192899613509e-4, 2.375751249879174e-5, -5.323896770569702e-6, -8.363313279112129e-6],
          [-62.32935833287916, -163.7920993367306, 25.29857947066878]),
}  # fmt: skip
FREQUENCIES = {
    False: [1276.6864363, 5106.74574521, 6840.81686358, 24612.65840743],
    True: [1276.6864363, 5106.74574521, 26494.36978712, 95324.41611789],
}

checks = []
for consistent, expected in FREQUENCIES.items():
    rod = model.Rod(consistent_mass=consistent)
    omega = np.sqrt(eigh(rod.stiffness, rod.mass, eigvals_only=True))
    name = "consistent" if consistent else "printed"
    error = float(np.abs(omega / expected - 1).max())
    checks.append(Check(f"frequencies with {name} axial mass, relative", error, 0.0, 1e-9))

scene = fmbd.Scene("slider crank")
crank = model.crank(model.Rod(), START)
scene.add(crank)
scene.sensor("coordinates", fmbd.coordinates(crank))
scene.sensor("multipliers", fmbd.reaction("crank"))
run = fmbd.solve(
    scene, t_end=t_end, scheme=fmbd.Radau(stages=3, form=fmbd.GGL(), rtol=rtol), output=fmbd.Output(energy=False)
)
say(run.report())
phi2, q, lam = END[t_end]
end = run["coordinates"][-1]
share = 10.0 if args.fast else 1.0
checks += [
    Check("phi2 at the end, rad", end[1], phi2, 1e-10 * share),
    Check("elastic coordinates, relative", float(np.abs(end[3:] / q - 1).max()), 0.0, 1e-5 * share),
    Check("multipliers, relative", float(np.abs(run["multipliers"][-1] / lam - 1).max()), 0.0, 1e-5 * share),
    Check("constraint, m", run.drift[0], 0.0, 1e-12),
]
if args.picture:
    run.plot("coordinates", "multipliers", file=str(args.picture))
finish(checks, run, args)
