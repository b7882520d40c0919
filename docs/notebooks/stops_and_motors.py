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
# # A motor against a stop
#
# A motor drives a hinge towards an angle beyond its stop: the arm bounces, then rests, and the motor winds up against it.

# %%
import fmbd_fenicsx as fmbd

arm = fmbd.RigidBody("arm", mass=2.0, inertia=0.1, position=(0.5, 0.0), shape=fmbd.contacts.Box((1.0, 0.06)))
hinge = fmbd.revolute("hinge", fmbd.ground, arm, center=(0, 0))
motor = fmbd.pid("motor", fmbd.angle(hinge), target=1.0, gains=(60.0, 20.0, 6.0))
stop = fmbd.joint_limit("stop", fmbd.angle(hinge), upper=0.7, restitution=0.5)

scene = fmbd.Scene("motor and stop", gravity=(0, -9.81))
scene.add(arm, hinge, motor, stop)
scene.sensor("angle", fmbd.angle(hinge))
scene.sensor("motor torque", fmbd.element_effort(motor))
scene.sensor("stop torque", fmbd.sensors.limit_effort(stop))
scene

# %%
run = fmbd.solve(scene, t_end=1.5, dt=5e-3, output=fmbd.Output(snapshots=30))
run

# %%
print(f"at rest at {run['angle'][-1, 0]:.6f} rad, held by {-run['stop torque'][-1, 0]:.3f} N m")

# %% [markdown]
# With pandas, the records are a table:

# %%
import importlib.util

run.to_pandas().tail() if importlib.util.find_spec("pandas") else run["angle"][-5:]

# %%
run.show()
