"""Limits of a linear floating body: what it says when it is used outside its range."""

from __future__ import annotations

TOO_LARGE = 0.5  # mean displacement over the body's size that no linear model survives


def too_large(body: str, displacement: float, size: float, stiffened: bool) -> str:
    """Message of a body whose displacements in its frame have grown out of any small-strain range; ``stiffened``: it has
    geometric stiffening.
    """
    spin = (
        "A body that spins above its first bending frequency has no stable linear solution: use stiffening=True with an "
        "attached frame, or an energy. Loads that set in at once in steps that do not resolve what they shake do the same: let "
        "them grow, or take a smaller dt."
    )
    bent = (
        "Its stiffening is of first order in the stress: take a smaller dt if it grew within a step; else an energy, or several "
        "bodies joined."
    )
    return (
        f'Body "{body}": its mean displacement in the floating frame has reached {displacement:.3g} m for a '
        f"size of {size:.3g} m. "
        f"A linear form is far outside its range there. {bent if stiffened else spin}"
    )
