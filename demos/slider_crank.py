"""Slider crank with an elastic connecting rod: the problem of the IVP test set, solved in its GGL form.

Run:  ./with-dolfinx python3 demos/slider_crank.py [--rod modes | elements] [--fast] [--json FILE] [--picture FILE]

Seven coordinates (demos/crank_model.py), three constraints, the crank driven at 150 rad/s, 0.1 s; --fast ends at 0.01 s. The
reference at 0.1 s is that of the test set's revision of 2006 (axial mass as printed, linear stiffness, no damping, smooth
start); that at 0.01 s and those of --consistent and --nonlinear at 0.1 s are own runs without constraints (order 8, 1e-13), whose
rates of phi2 and x3 follow from the others, 1e-8 m/s away from ours. --damped and --start rigid have no reference: the end
values are printed. --forms solves in five forms of the equations and compares.
--rod elements: the same crank with a rod of finite elements, demos/slider_crank_fe.py.
"""

import sys

import crank_model as model
import numpy as np
import slider_crank_fe
from scipy.linalg import eigh

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.faces.demo import Check, arguments, finish, say

OWN = {"--consistent": False, "--nonlinear": False, "--damped": False, "--start": ("smooth", "rigid"), "--forms": False}
args = arguments(__doc__, {"--rod": ("modes", "elements"), **OWN, **slider_crank_fe.OWN})
if args.rod == "elements":
    sys.exit(slider_crank_fe.main(args))
rod = model.Rod(consistent_mass=args.consistent, nonlinear=args.nonlinear, damped=args.damped)
t_end = 0.01 if args.fast else 0.1
END = {  # end, consistent, nonlinear: phi2, q1..q4, lambda, and to what share q and lambda are known
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

checks = []
for consistent, expected in FREQUENCIES.items():
    omega = np.sqrt(eigh((r := model.Rod(consistent_mass=consistent)).stiffness, r.mass, eigvals_only=True))
    error = float(np.abs(omega / expected - 1).max())
    name = "consistent" if consistent else "printed"
    checks.append(Check(f"frequencies with {name} axial mass, relative", error, 0.0, 1e-9))


def solved(form, rtol=1e-8):
    """A run in one form, seven stages."""
    scene = model.scene(rod, model.STARTS[args.start])
    return fmbd.solve(scene, t_end=t_end, scheme=fmbd.Radau(7, form, rtol), output=fmbd.Output(energy=False))


run = solved(fmbd.GGL())
end, lam = run["coordinates"][-1], run["multipliers"][-1]
say("phi2, q1..q4: " + "  ".join(f"{x:.13e}" for x in (end[1], *end[3:])))
say("lambda:       " + "  ".join(f"{x:.13e}" for x in lam))
checks.append(Check("constraint, m", run.drift[0], 0.0, 1e-12))
if args.start == "smooth" and not args.damped and (t_end, args.consistent, args.nonlinear) in END:
    phi2, q, known, share = END[t_end, args.consistent, args.nonlinear]
    checks += [
        Check("phi2 at the end, rad", end[1], phi2, 1e-11),
        Check("elastic coordinates, relative", float(np.abs(end[3:] / q - 1).max()), 0.0, share),
        Check("multipliers, relative", float(np.abs(lam / known - 1).max()), 0.0, share),
    ]
forms = (fmbd.Index3(), fmbd.Index2(), fmbd.Index1(), fmbd.StateSpace(), fmbd.Projected(fmbd.Index1()))
for form in forms if args.forms else ():
    other = solved(form)
    same = 1e-6 if form.index == 3 else 1e-8  # index 3: lower order of velocities and multipliers
    q = float(np.abs(other["coordinates"][-1][3:] / end[3:] - 1).max())
    checks.append(Check(f"{form.name}: elastic coordinates against GGL, relative", q, 0.0, same))
    known = float(np.abs(other["multipliers"][-1] / lam - 1).max())
    checks.append(Check(f"{form.name}: multipliers against GGL, relative", known, 0.0, same))
if args.picture:
    run.plot("coordinates", "multipliers", file=args.picture)
finish(checks, run, args)
