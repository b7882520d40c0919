"""Animations of a run: its drawing in motion, beside it the histories of sensors with a moving dot. GIF, MP4, or a web page, that
a notebook or the web browser of this machine shows.

Drawn without a window on rank 0; the drawing is gathered on all ranks.
"""

from __future__ import annotations

import html
import os
import shutil
import subprocess
import sys
import tempfile
import webbrowser
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..checks import typed
from ..errors import InputError, require
from ..ranks import on_root
from ..rotations import Array
from ..run.result import Run
from .drawing.draw import draw
from .drawing.render import Renderer
from .drawing.scene_graph import Drawing
from .drawing.view import Paint, View
from .exchange.files import write_whole
from .figures import STYLE
from .plot import arrow_legend, draw_history, series_of

FASTEST = 50.0  # frames a second: what a GIF can do
KINDS = (".gif", ".mp4", ".html")


@dataclass(frozen=True)
class Story:
    """What an animation is made of: the run, its drawing, the view, sensors, seconds that it lasts."""

    run: Run
    drawing: Drawing
    view: View
    sensors: Sequence[str]
    seconds: float

    @property
    def frames(self) -> list[int]:
        """Numbers of the snapshots that are shown one after the other, at even distances in time."""
        times = self.drawing.times
        count = min(len(times), max(int(FASTEST * self.seconds), 2))
        even = np.linspace(times[0], times[-1], count)
        return [int(np.argmin(np.abs(times - t))) for t in even]

    @property
    def pace(self) -> str:
        """How fast time passes, in words."""
        span = float(self.drawing.times[-1] - self.drawing.times[0])
        ratio = self.seconds / span if span > 0 else 1.0
        if 0.95 < ratio < 1.05:
            return "in real time"
        return f"slowed {ratio:.3g} times" if ratio > 1 else f"{1 / ratio:.3g} times faster"


@typed
def animate(
    run: Run,
    file: str | Path,
    *,
    sensors: str | Sequence[str] = (),
    view: View | None = None,
    paint: Paint | None = None,
    seconds: float | None = None,
) -> Path:
    """Write an animation of all snapshots; see :meth:`fmbd_fenicsx.Run.animate`. Collective, rank 0 writes."""
    file = Path(file)
    kind = file.suffix.lower()
    require(kind in KINDS, f'Animation "{file}": the name must end in .gif, .mp4 or .html, found "{kind}".')
    story = make_story(run, sensors, view or View(), paint, seconds)
    if kind == ".mp4":
        _encoder()  # on all ranks: an error before anything is drawn

    def write(place: Path) -> None:
        if kind == ".html":
            from .webpage import page

            place.write_text(page(story), encoding="utf-8")
        elif kind == ".gif":
            _write_gif(place, story)
        else:
            _write_mp4(place, story)

    on_root(run.system.comm, lambda: write_whole("The animation", file, write))
    return file


def make_story(run: Run, sensors: Sequence[str] | str, view: View, paint: Paint | None, seconds: float | None) -> Story:
    """The drawing of all snapshots and how long it lasts; collective."""
    names = (sensors,) if isinstance(sensors, str) else tuple(sensors)
    for name in names:
        series_of(run, name)
    require(
        len(run.snapshots) >= 2,
        f"An animation shows snapshots, and this run has {len(run.snapshots)}: "
        "solve(..., output=fmbd.Output(snapshots=100)).",
    )
    drawing = draw(run, view=view, paint=paint)
    span = float(drawing.times[-1] - drawing.times[0])
    # runs of some seconds in real time, others in five
    usual = span if 2.0 <= span <= 12.0 else 5.0
    lasts = usual if seconds is None else float(seconds)
    require(np.isfinite(lasts) and lasts > 0, f"Animation: seconds = {seconds} must be positive.")
    return Story(run, drawing, view, names, lasts)


@dataclass(frozen=True, repr=False)
class Shown:
    """A page that a notebook shows as the last expression of a cell."""

    page: str

    def _repr_html_(self) -> str:
        style = "width: 100%; height: 520px; border: 0"
        return f'<iframe srcdoc="{html.escape(self.page)}" style="{style}"></iframe>'

    def __repr__(self) -> str:
        return f"<animation, {len(self.page) // 1000} kB>"


def show(run: Run, *, sensors: Sequence[str] | str = (), view: View | None = None, paint: Paint | None = None) -> Any:
    """See :meth:`fmbd_fenicsx.Run.show`; collective."""
    story = make_story(run, sensors, view or View(), paint, None)
    from .webpage import page

    if "ipykernel" in sys.modules:
        return Shown(page(story))

    # what says that there is a screen; macOS has always one
    if not any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY")) and sys.platform != "darwin":
        raise InputError('There is no screen here. run.animate("run.html") writes a page that any browser shows.')

    def open_page() -> None:
        file = Path(tempfile.mkdtemp(prefix="fmbd_")) / "run.html"
        file.write_text(page(story), encoding="utf-8")
        webbrowser.open(file.as_uri())

    on_root(run.system.comm, open_page)
    return None


# -- frames ------------------------------------------------------------------------------------------------------
def frames(story: Story, chosen: Sequence[int] | None = None) -> Iterator[Array]:
    """Images (rows, columns, 3), one for each frame, or for the ``chosen`` snapshots; rank 0."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    width, height = story.view.size
    share = 0.6 if story.sensors else 1.0
    flat = story.drawing.dim == 2 and story.view.camera is None
    scene_size = int(share * width) - (70 if flat else 0), height - 90
    scene = Renderer(story.drawing, story.view, size=scene_size)
    scene.add(0)
    scene.look()
    scene.smooth()

    with rc_context(STYLE):
        page = _Page(story, share)
        canvas = FigureCanvasAgg(page.figure)
        first = scene.image()
        page.show(first)
        canvas.draw()
        # what stays is drawn once; each frame restores it
        still = canvas.copy_from_bbox(page.figure.bbox)
        for k in story.frames if chosen is None else chosen:
            scene.turn_to(k)
            canvas.restore_region(still)
            page.turn_to(k, scene.image())
            yield np.asarray(canvas.buffer_rgba())[..., :3].copy()
    scene.close()


class _Page:
    """Axes of an animation: the scene to the left, sensors to the right, the time above."""

    def __init__(self, story: Story, share: float) -> None:
        from matplotlib.figure import Figure

        self.story = story
        width, height = story.view.size
        self.figure = Figure(figsize=(width / 100, height / 100), dpi=100)
        self.figure.text(0.5, 0.97, story.run.scene.name, ha="center", va="top", fontsize=11)

        # the scene, with room for the axes' numbers in the plane and for the colour bar
        flat = story.drawing.dim == 2 and story.view.camera is None
        left, below = (70 / width, 50 / height) if flat else (0.005, 0.01)
        right = share - (0.1 if story.drawing.label else 0.01)
        self.scene = self.figure.add_axes((left, below, right - left, 1 - below - 60 / height))
        self.flat = flat
        if story.drawing.label:
            self._color_bar(right)
        arrow_legend(self.scene, story.drawing, loc="lower right", bbox_to_anchor=(1.0, 1.0), fontsize=8)
        self.clock = self.figure.text(0.01, 0.97, "", ha="left", va="top", fontsize=10, family="monospace")
        self.clock.set_animated(True)
        self.dots = self._curves(share)

    def _color_bar(self, left: float) -> None:
        import matplotlib

        axes = self.figure.add_axes((left + 0.012, 0.2, 0.014, 0.55))
        scale = matplotlib.cm.ScalarMappable(matplotlib.colors.Normalize(*self.story.drawing.span), "viridis")
        self.figure.colorbar(scale, cax=axes, label=self.story.drawing.label)

    def _curves(self, share: float) -> list[tuple[Any, Array, Array]]:
        """Histories with a dot for each component: (artist, times, values)."""
        run = self.story.run
        count = len(self.story.sensors)
        found = []
        for k, name in enumerate(self.story.sensors):
            height = 0.86 / count
            box = (share + 0.095, 0.93 - height * (k + 1) + 0.11, 1 - share - 0.12, height - 0.19 / max(1, 0.6 * count))

            axes = self.figure.add_axes(box)
            draw_history(axes, run, name)

            # the name of the axis in letters that fit its height: one of size 9 is about 7 pixels wide
            pixels = box[3] * self.story.view.size[1]
            axes.yaxis.label.set_fontsize(min(9.0, max(6.0, 9.0 * 1.15 * pixels / (7.0 * len(axes.get_ylabel()) + 1))))

            if axes.get_legend() is not None:
                room = {"ncols": 6, "fontsize": 7, "columnspacing": 1.0, "handlelength": 1.2, "borderaxespad": 0.0}
                axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), **room)
            if k == count - 1:
                axes.set_xlabel("time (s)")

            for line in list(axes.lines):
                look = {"color": line.get_color(), "markersize": 7, "markeredgecolor": "k", "clip_on": False}
                (dot,) = axes.plot([], [], "o", animated=True, **look)
                found.append((dot, np.asarray(line.get_xdata()), np.asarray(line.get_ydata())))
        return found

    def show(self, picture: Any) -> None:
        """Put the scene's first image in its place."""
        shown = {"extent": picture.extent, "aspect": "equal" if self.flat else "auto", "animated": True}
        self.scene.grid(False)
        self.image = self.scene.imshow(picture.image, interpolation="antialiased", **shown)
        if self.flat:
            self.scene.set(xlabel="x (m)", ylabel="y (m)")
            self.scene.locator_params(nbins=6)
        else:
            self.scene.set_aspect("equal")
            self.scene.axis("off")

    def turn_to(self, k: int, picture: Any) -> None:
        """Draw what changes: image, dots, time."""
        t = float(self.story.drawing.times[k])
        self.image.set_data(picture.image)
        self.scene.draw_artist(self.image)
        for dot, times, values in self.dots:
            row = int(np.argmin(np.abs(times - t)))
            dot.set_data([times[row]], [values[row]])
            dot.axes.draw_artist(dot)
        self.clock.set_text(f"t = {t:8.4g} s\n{self.story.pace}")
        self.figure.draw_artist(self.clock)


# -- files -------------------------------------------------------------------------------------------------------
def _write_gif(file: Path, story: Story) -> None:
    from PIL import Image

    # one palette for all: from a few frames side by side; each frame's own takes as long as drawing it, and flickers
    few = story.frames[:: max(len(story.frames) // 5, 1)]
    found = Image.fromarray(np.concatenate(list(frames(story, few)))).quantize(128).getpalette() or []
    colors = np.array(found, dtype=int).reshape(-1, 3)
    colors[colors.min(axis=1) > 240] = 255  # the background is white, not nearly
    palette = Image.new("P", (1, 1))
    palette.putpalette(colors.ravel().tolist())
    plain = {"palette": palette, "dither": Image.Dither.NONE}
    made = [Image.fromarray(frame).quantize(**plain) for frame in frames(story)]
    duration = max(int(round(100 * story.seconds / len(made))), 2) * 10  # ms; a GIF counts in hundredths of a second
    made[0].save(file, save_all=True, append_images=made[1:], duration=duration, loop=0, optimize=False)


def _encoder() -> str:
    """The ffmpeg of the machine or of the package imageio-ffmpeg."""
    found = shutil.which("ffmpeg")
    if found:
        return found
    try:
        import imageio_ffmpeg
    except ImportError:
        raise InputError(
            "An .mp4 needs ffmpeg, which is not here (Debian: apt install ffmpeg; or pip install imageio-ffmpeg). "
            "What works without it: .gif and .html."
        ) from None
    return str(imageio_ffmpeg.get_ffmpeg_exe())


def _write_mp4(file: Path, story: Story) -> None:
    width, height = (n - n % 2 for n in story.view.size)  # the codec wants even numbers
    rate = f"{len(story.frames) / story.seconds:.6g}"
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", rate, "-i", "-"]
    codec = ["-an", "-vcodec", "libx264", "-pix_fmt", "yuv420p", str(file)]
    command = [_encoder(), "-y", "-loglevel", "error", *given, *codec]

    process = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdin is not None and process.stderr is not None
    try:
        for frame in frames(story):
            process.stdin.write(np.ascontiguousarray(frame[:height, :width]).tobytes())
    except BrokenPipeError:
        pass  # what went wrong is in its messages
    process.stdin.close()
    message = process.stderr.read().decode(errors="replace").strip()
    if process.wait() != 0:
        raise InputError(f'ffmpeg could not write "{file}": {message}')
