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
from fmbd_fenicsx.post.demo import Check, arguments, finish, say, show, snapshots

OWN = {"--consistent": False, "--nonlinear": False, "--damped": False, "--start": ("smooth", "rigid"), "--forms": False}
args = arguments(__doc__, {"--rod": ("modes", "elements"), **OWN, **slider_crank_fe.OWN})
if args.rod == "elements":
    sys.exit(slider_crank_fe.main(args))
rod = model.Rod(consistent_mass=args.consistent, nonlinear=args.nonlinear, damped=args.damped)
t_end = 0.01 if args.fast else 0.1


def solved(form):
    """A run in one form, seven stages."""
    scene, scheme = model.scene(rod, model.STARTS[args.start]), fmbd.Radau(7, form, rtol=1e-8)
    return fmbd.solve(scene, t_end=t_end, scheme=scheme, output=snapshots(args, energy=False))


def off(values, reference):
    """Largest relative difference."""
    return np.abs(np.divide(values, reference) - 1).max()


run = solved(fmbd.GGL())
end, lam = run["coordinates"][-1], run["multipliers"][-1]
say("phi2, q1..q4: " + "  ".join(f"{x:.13e}" for x in (end[1], *end[3:])))
say("lambda:       " + "  ".join(f"{x:.13e}" for x in lam))
checks = [Check("constraint, m", run.drift[0], 0.0, 1e-12)]
for consistent, expected in model.FREQUENCIES.items():
    omega = np.sqrt(eigh((r := model.Rod(consistent_mass=consistent)).stiffness, r.mass, eigvals_only=True))
    name = f"frequencies with {'consistent' if consistent else 'printed'} axial mass, relative"
    checks.append(Check(name, off(omega, expected), 0.0, 1e-9))
known = args.start == "smooth" and not args.damped and model.ENDS.get((t_end, args.consistent, args.nonlinear))
if known:
    phi2, q, multipliers, share = known
    checks += [
        Check("phi2 at the end, rad", end[1], phi2, 1e-11),
        Check("elastic coordinates, relative", off(end[3:], q), 0.0, share),
        Check("multipliers, relative", off(lam, multipliers), 0.0, share),
    ]
forms = (fmbd.Index3(), fmbd.Index2(), fmbd.Index1(), fmbd.StateSpace(), fmbd.Projected(fmbd.Index1()))
for form in forms if args.forms else ():
    other, same = solved(form), 1e-6 if form.index == 3 else 1e-8  # index 3: lower order of velocities and multipliers
    q, found = off(other["coordinates"][-1][3:], end[3:]), off(other["multipliers"][-1], lam)
    checks.append(Check(f"{form.name}: elastic coordinates against GGL, relative", q, 0.0, same))
    checks.append(Check(f"{form.name}: multipliers against GGL, relative", found, 0.0, same))
at_end = {"multipliers": (t_end, known[2]), "coordinates q1": (t_end, known[1][0])} if known else {}
show(run, args, ["coordinates q1", "coordinates q4", "multipliers"], reference=at_end)
finish(checks, run, args)
