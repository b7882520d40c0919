"""A drawing of rods with their sections, for the demos of rods."""

import numpy as np

from fmbd_fenicsx.post.drawing.rods import skin


def panels(file, content, title):
    """Pictures side by side: title -> [(rod, poses of its nodes), ...], from light (early) to dark (late)."""
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    # names of axes in space reach beyond their panel
    layout = ConstrainedLayoutEngine(rect=(0.0, 0.0, 0.95, 1.0))
    page = Figure(figsize=(5.5 * len(content), 4.5), layout=layout)
    page.suptitle(title, fontsize=10)
    for k, (name, shapes) in enumerate(content.items()):
        axes = page.add_subplot(1, len(content), k + 1, projection="3d")
        for i, (rod, pose) in enumerate(shapes):
            rings = skin(rod, pose)
            rings = np.concatenate((rings, rings[:, :1]), axis=1)
            shade = 0.25 + 0.75 * (i + 1) / len(shapes)
            color = (1 - 0.8 * shade, 1 - 0.55 * shade, 1 - 0.3 * shade)
            axes.plot_surface(*np.moveaxis(rings, -1, 0), color=color, rstride=1, cstride=1, linewidth=0)
        axes.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)")
        axes.set_title(name, y=0.96)
        axes.locator_params(nbins=4)

        # to scale, with room for names of axes below what is high
        widths = {c: np.ptp(getattr(axes, f"get_{c}lim")()) for c in "xyz"}
        axes.set_box_aspect(tuple(widths.values()), zoom=1 - 0.2 * widths["z"] / max(widths.values()))

        # no numbers along a side where they would lie over each other, and names beyond the numbers
        flat = [c for c, width in widths.items() if width < 0.15 * max(widths.values())]
        for c in flat:
            axes.set(**{f"{c}ticks": [], f"{c}label": ""})
        axes.xaxis.labelpad = axes.yaxis.labelpad = 26 if flat else 14
    page.savefig(file, dpi=120)
