"""Arrays by which Python and the driver tell each other of states and of right-hand sides."""

from __future__ import annotations

from ....rotations import Array
from ...system import System
from ..tables.structures import Sizes, zeros_of


class Exchange:
    """Arrays of the given sizes that C knows by their addresses ``at``."""

    def __init__(self, sizes: Sizes) -> None:
        made = zeros_of(sizes).values()
        self.arrays = [x for x, _ in made]
        self.at = [address for _, address in made]

    def put(self, *values: Array | None) -> list[int]:
        """Copy in the first arrays, as far as there are values, or their first rows; their addresses."""
        for x, value in zip(self.arrays, values, strict=False):
            if value is not None:
                (x if x.ndim == value.ndim else x[0])[:] = value
        return self.at[: len(values)]


class Room:
    """What C reads and writes of the first ``count`` of at most so many configurations: t, q and v; a; lambda; the sums of the
    balance; four of the rows; energies.
    """

    def __init__(self, system: System, most: int) -> None:
        n, m = (most, system.n_v), (most, system.n_lam)
        self.most = self.count = most
        q, energies = (most, system.n_q), (most, 4)
        made = zeros_of({"t": most, "q": q, "v": n, "a": n, "lam": m, "sums": n, "rows": (4, *m), "energies": energies})
        self.places = {name: address for name, (_, address) in made.items()}
        self.state = [made[name][0] for name in "tqv"]
        self.at = [most, *[self.places[name] for name in "tqv"]]  # how many, and where the configurations are
        self.a, self.lam, self.sums, self.energies = [made[name][0] for name in ("a", "lam", "sums", "energies")]
        self.constraints = made["rows"][0]
        self.constraints_at = [self.places["rows"] + x * self.constraints.strides[0] for x in range(4)]
