"""Chains of equal links in the plane, with which many tests begin."""

from __future__ import annotations

from typing import Any

import fmbd_fenicsx as fmbd


def chain(
    n: int, name: str = "chain", *, length: float = 1.0, mass: float = 1.0, inertia: float = 1 / 12, **more: Any
) -> tuple[fmbd.Scene, Any]:
    """n links that fall from the horizontal, on hinges "pin 0", "pin 1" ..; the scene, and the last link."""
    scene, last = fmbd.Scene(name, gravity=(0.0, -9.81), **more), fmbd.ground
    for k in range(n):
        link = fmbd.RigidBody(f"link {k}", mass, inertia, ((k + 0.5) * length, 0.0))
        scene.add(link, fmbd.revolute(f"pin {k}", last, link, center=(k * length, 0.0)))
        last = link
    return scene, last
