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
# # An elastic pendulum
#
# A soft rod on a pin, released from the horizontal. Start Jupyter in the folder of the clone.

# %%
import fmbd_fenicsx as fmbd

mesh = fmbd.read_gmsh("meshes/rod.py", dim=2, h=0.1)  # surfaces "pin", "tip", "side"
rod = fmbd.FloatingBody("rod", mesh, density=1000.0, elastic=fmbd.materials.linear_elastic(5e6, 0.3))
pin = fmbd.revolute("pin", fmbd.ground, rod.surface("pin"), center=(0, 0, 0))

scene = fmbd.Scene("elastic pendulum", gravity=(0, -9.81, 0))
scene.add(rod, pin)
scene.sensor("tip", fmbd.position(rod.surface("tip")))
scene

# %% [markdown]
# A scene and a run show themselves as the last line of a cell. The error of the steps is found by runs with two and
# four times the step.

# %%
run = fmbd.solve(scene, t_end=0.5, dt=5e-3, output=fmbd.Output(snapshots=20, estimate_error=True))
run

# %%
print(f"tip at the end {run['tip'][-1]} m, error of the steps about {run.error_estimate['tip']:.1e} m")

# %% [markdown]
# The motion, to turn and to play:

# %%
run.show()
