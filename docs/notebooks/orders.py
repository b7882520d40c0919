# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Orders of convergence
#
# The same pendulum by three schemes, with steps that are halved: how fast do their errors fall?

# %%
import fmbd_fenicsx as fmbd
from fmbd_fenicsx import study

arm = fmbd.RigidBody("arm", mass=1.0, inertia=0.1, position=(0.5, 0.0))
scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
scene.add(arm, fmbd.revolute("pin", fmbd.ground, arm, center=(0, 0)))
scene.sensor("arm", fmbd.position(arm))
steps = [0.04, 0.02, 0.01, 0.005]

# %%
study.orders(lambda h: fmbd.solve(scene, t_end=0.4, dt=h), steps, names=["arm"])

# %%
study.orders(lambda h: fmbd.solve(scene, t_end=0.4, dt=h, scheme=fmbd.EnergyMomentum()), steps, names=["arm"])

# %% [markdown]
# Radau IIA with two stages has order three:

# %%
study.orders(
    lambda h: fmbd.solve(scene, t_end=0.4, dt=h, scheme=fmbd.Radau(2, fmbd.GGL(), rtol=None)), steps, names=["arm"]
)
