"""Animations: every frame shows its instant; files are what their names say; mistakes are told before anything is drawn."""

from __future__ import annotations

import base64
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fmbd_fenicsx as fmbd
from fmbd_fenicsx.errors import InputError
from fmbd_fenicsx.post import animation
from fmbd_fenicsx.post.drawing.draw import draw
from fmbd_fenicsx.post.drawing.view import View

SOFT = fmbd.materials.linear_elastic(5e6, 0.3)
SMALL = View(size=(320, 200))


def swing(snapshots: Any = 5) -> fmbd.Run:
    bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(1.0, 0.0), shape=fmbd.contacts.Sphere(0.2))
    scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
    scene.add(bob, fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0)))
    scene.sensor("bob", fmbd.sensors.position(bob))
    return fmbd.solve(scene, t_end=0.5, dt=0.01, output=fmbd.Output(snapshots=snapshots))


def center_of_body(frame: np.ndarray) -> np.ndarray:
    """Mean row and column of the pixels in the colour of the first body."""
    rgb = frame.astype(int)
    on = np.abs(rgb - [76, 120, 168]).sum(2) < 40
    return np.argwhere(on).mean(0)


@pytest.mark.serial
def test_frames_follow_the_motion() -> None:
    pytest.importorskip("pyvista")
    run = swing()
    shown = list(animation.frames(animation.make_story(run, ("bob y",), SMALL, None, 1.0)))
    assert len(shown) == 5 and all(f.shape == (200, 320, 3) for f in shown)
    places = np.array([center_of_body(f) for f in shown])
    heights = np.array([run["bob"][int(round(s.t / 0.01)), 1] for s in run.snapshots])

    # pixels go down as the bob does, by one scale
    assert np.polyfit(heights, places[:, 0], 1)[0] < 0
    assert np.corrcoef(heights, places[:, 0])[0, 1] < -0.99


@pytest.mark.serial
def test_gif_holds_all_frames_and_lasts_as_asked(tmp_path: Path) -> None:
    pytest.importorskip("pyvista")
    from PIL import Image

    file = swing().animate(tmp_path / "swing.gif", sensors="bob", view=SMALL, seconds=2.0)
    with Image.open(file) as image:
        assert image.n_frames == 5 and image.size == (320, 200)
        assert 5 * image.info["duration"] == pytest.approx(2000, rel=0.05)
        assert image.convert("RGB").getpixel((319, 199)) == (
            255,
            255,
            255,
        )  # one palette for all frames, with white in it


@pytest.mark.serial
@pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="no ffmpeg")
def test_mp4_is_written(tmp_path: Path) -> None:
    file = swing().animate(tmp_path / "swing.mp4", view=SMALL)
    assert file.read_bytes()[4:8] == b"ftyp"


def test_mp4_without_ffmpeg_says_what_works(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr(shutil, "which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"needs ffmpeg.*\.gif and \.html"):
        swing().animate(tmp_path / "swing.mp4")


def test_mistakes_are_told(tmp_path: Path) -> None:
    run = swing()
    with pytest.raises(InputError, match=r"\.gif, \.mp4 or \.html"):
        run.animate(tmp_path / "swing.avi")
    with pytest.raises(InputError, match='Did you mean "bob"'):
        run.animate(tmp_path / "swing.gif", sensors="bobb")
    with pytest.raises(InputError, match="seconds = -1"):
        run.animate(tmp_path / "swing.gif", seconds=-1)
    with pytest.raises(InputError, match="The animation cannot be written to .*No such file"):
        run.animate(tmp_path / "nowhere" / "swing.gif")
    for few in (0, 1):
        with pytest.raises(InputError, match="snapshots=100"):
            swing(few).animate(tmp_path / "swing.gif")


@pytest.mark.serial
def test_pace_is_said_in_words() -> None:
    run = swing()
    story = animation.make_story(run, (), SMALL, None, 5.0)
    assert story.pace == "slowed 10 times"
    assert animation.make_story(run, (), SMALL, None, 0.5).pace == "in real time"
    assert animation.make_story(run, (), SMALL, None, 0.05).pace == "10 times faster"


@pytest.mark.serial
def test_a_run_that_shows_nothing_loads_nothing_of_it() -> None:
    code = """
import sys
import fmbd_fenicsx as fmbd
bob = fmbd.RigidBody("bob", 1.0, 0.1, position=(1.0, 0.0), shape=fmbd.contacts.Sphere(0.2))
scene = fmbd.Scene("pendulum", gravity=(0, -9.81))
scene.add(bob, fmbd.revolute("pin", fmbd.ground, bob, center=(0, 0)))
run = fmbd.solve(scene, t_end=0.1, dt=0.05, output=fmbd.Output(snapshots=2))
unwanted = ("fmbd_fenicsx.post.drawing", "fmbd_fenicsx.post.animation", "dolfinx", "pyvista")
print([m for m in sys.modules if m.startswith(unwanted)])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
    assert done.stdout.strip() == "[]"


def test_web_page_holds_the_motion_and_needs_nothing_else(tmp_path: Path) -> None:
    run = swing()
    text = run.animate(tmp_path / "swing.html", sensors="bob").read_text()
    assert "http" not in text.replace("http-equiv", "")  # no network

    data = json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', text, re.DOTALL)[1])  # type: ignore[index]
    bob = next(p for p in data["pieces"] if p["name"] == "bob")
    points = np.frombuffer(base64.b64decode(bob["points"]), "<f4").reshape(-1, 3)
    places = np.frombuffer(base64.b64decode(bob["places"]), "<f4").reshape(-1, 12)
    assert data["times"] == pytest.approx([s.t for s in run.snapshots])
    assert np.abs(points[:48]).max() == pytest.approx(0.2)
    assert places[-1, 9:11] == pytest.approx(run["bob"][-1], abs=1e-6)
    assert data["curves"][0]["name"] == "bob (m)" and len(data["curves"][0]["values"]) == 2


def test_web_page_keeps_colours_beside_the_scene_and_ticks_at_multiples() -> None:
    """The colour bar has a canvas of its own; ticks are multiples of their step, so that zero is not -5.6e-17."""
    from fmbd_fenicsx.post.webpage import VIEWER

    text = VIEWER.read_text()
    assert '<canvas id="bar"' in text and "calc(100% - 96px)" in text
    drawn_on = re.search(r"function colors\(\).*?getElementById\(\"(\w+)\"\)", text, re.DOTALL)
    assert drawn_on is not None and drawn_on[1] == "bar"
    assert not re.search(r"for \(let \w = Math.ceil[^)]*\)[^)]*\+= ", text)


def test_web_page_holds_deformed_bodies_to_a_part_of_their_size(tmp_path: Path, rod_mesh: Any) -> None:
    """Points of deforming bodies are sent as shares of the box that they move in, in 16 bits."""
    rod = fmbd.FloatingBody(
        "rod", rod_mesh(h=0.5, height=0.4), degree=1, density=1e3, elastic=SOFT, velocity=(1.0, 2.0)
    )
    scene = fmbd.Scene("flight", gravity=(0, -9.81))
    scene.add(rod)
    run = fmbd.solve(scene, t_end=0.2, dt=0.05, output=fmbd.Output(snapshots=3))
    text = run.animate(tmp_path / "flight.html").read_text()
    data = json.loads(re.search(r'<script id="data"[^>]*>(.*?)</script>', text, re.DOTALL)[1])  # type: ignore[index]

    sent = next(p for p in data["pieces"] if p["name"] == "rod")
    shares = np.frombuffer(base64.b64decode(sent["deforming"]), "<u2").reshape(len(run.snapshots), -1, 3) / 65535
    x = np.asarray(sent["low"]) + shares * np.asarray(sent["size"])
    shown = next(p for p in draw(run).pieces if p.name == "rod")
    for k in range(len(run.snapshots)):
        assert x[k] == pytest.approx(shown.at(k), abs=1e-4)
