"""Loops of beds: frames, duration, size, transparency, and the run that a file knows again."""

from io import BytesIO
from typing import Any

import numpy as np
from PIL import Image

from labbook.backend.numerics import Numerics
from labbook.export.colouring import Colouring
from labbook.export.film import Shot
from labbook.export.frames import Frame
from labbook.export.loop import FRAMES, encoded
from labbook.measure import RunData
from labbook.scene import HertzMindlin, Packing, Scene, Spheres, WedgeHopper

D = 3e-3
BED = np.array([(-0.01, 0.0, 0.01), (0.0, 0.0, 0.03), (0.01, 0.0, 0.01)])


def falling(count: int) -> Shot:
    """A run of three grains that fall by a diameter, with `count` frames."""
    start = Packing(x=BED, v=0 * BED, omega=0 * BED)
    law = HertzMindlin(shear_modulus=5e6, poisson_ratio=0.25, friction=0.5, restitution=0.2)
    hopper = WedgeHopper(width=0.04, height=0.3, thickness=1.01 * D, orifice=0.012)
    scene = Scene(grains=Spheres(diameter=D, density=2500, count=3), contact=law, container=hopper)
    times = np.linspace(0, 1, count)
    frames = [Frame(float(t), (BED - [0, 0, D * t]).astype(np.float32), 0 * BED, np.arange(3), None) for t in times]
    data = RunData(scene, Numerics(dt=1e-5), 1, start, "finished", 1.0, {})
    return Shot(data, frames, Colouring.of("layers", scene, start, frames), "a run")


def test_a_loop_shows_the_whole_run_in_few_frames_again_and_again():
    image: Any = Image.open(BytesIO(encoded(falling(50), seconds=4.0, size=90, source="a source")))
    assert (image.n_frames, image.info["loop"], image.info["xmp"]) == (FRAMES, 0, b"a source")
    assert max(image.size) <= 90
    image.load()
    assert abs(FRAMES * image.info["duration"] - 4000) <= FRAMES  # whole milliseconds


def test_a_loop_has_no_more_frames_than_the_run():
    image: Any = Image.open(BytesIO(encoded(falling(5))))
    assert image.n_frames == 5


def test_grains_of_a_loop_move_on_a_page_of_any_colour():
    """Around grains and walls the page is seen; the grains end a diameter lower, so their middle does too."""
    image: Any = Image.open(BytesIO(encoded(falling(9), size=200)))
    middles = []
    for k in (0, image.n_frames - 1):
        image.seek(k)
        alpha = np.asarray(image.convert("RGBA"))[..., 3]
        assert alpha.min() == 0
        inside = alpha[:, 12:-12] > 128  # without the walls at the sides
        bottom = np.flatnonzero(inside.mean(axis=1) > 0.3)  # rows of the bottom beside the outlet
        inside[bottom] = False
        middles.append(np.nonzero(inside)[0].mean())
    scale = 200 / (max(BED[:, 2]) - min(BED[:, 2]))  # pixels per metre at most: the view holds more than the grains
    assert 2 < middles[1] - middles[0] < scale * D
