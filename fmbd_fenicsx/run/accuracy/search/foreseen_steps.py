"""How small the steps of an attempt have to be, told before it is made by runs that tell its error afterwards.

A look at spaces says nothing of what its steps leave. Where it is not likely to tell the error of the attempt alone, a run with
half of the planned steps shows the order beside it: made first, both say how many steps are needed.
"""

from __future__ import annotations

import numpy as np

from ....system.scene.refinement import slender
from ...recording.output import Output
from ..certificate import FLOOR, moving
from ..companion_runs import UNFIT
from ..deviation import Deviation
from ..equal_steps import NEAREST, compare_steps
from ..orders import expected_orders
from .next_attempt import LEAST, NEAR, SURE, AttemptPlan, finer_steps, looking, space_limit
from .shared_spaces import SharedSpaces
from .shares import WHOLE, Tolerance, largest_share

# of the range of a sensor: what a look is thought to differ by from an attempt, where nothing is known of it
LEAVES = 4e-3


def with_steps_foreseen(plan: AttemptPlan, tol: Tolerance, shared: SharedSpaces, wanted: Output) -> AttemptPlan:
    """The plan of an attempt in new spaces of slender bodies, fine enough, with as many more steps as the error of half of them
    asks for; as it is where the order has to be seen first, or the look is likely to tell its error; collective.
    """
    look, over = shared.kept(plan.scene, plan.orders.follow), shared.looked.get(id(plan.scene), np.inf)
    if look is None or over > space_limit(plan.scene) or plan.orders.seen or not slender(plan.scene):
        return plan
    series, times = look.recorder.series, look.recorder.times
    spans, room = moving(series, plan.scene.sensors, FLOOR), WHOLE - over
    usual = {n: Deviation(times, np.full_like(x, LEAVES * np.ptp(x, axis=0))) for n, x in series.items()}
    half = plan.schedule.with_steps(plan.steps // 2)
    if half.steps < NEAREST * look.steps or largest_share(usual, spans, tol) <= room:
        return plan
    try:
        made = shared.look(plan.scene, plan.scheme, half, looking(wanted))
    except UNFIT:
        return plan

    orders = expected_orders(plan.scheme, plan.scene, shared.ahead(plan.scene).system)
    order = min(orders[n] for n in tol)
    left = largest_share(compare_steps(orders, made, [look]).errors, spans, tol) * (half.steps / plan.steps) ** order
    factor = (SURE * room / left) ** (1.0 / order) if left > room else 1.0
    return finer_steps(plan, min(factor, LEAST)) if NEAR <= factor < 1.0 else plan
