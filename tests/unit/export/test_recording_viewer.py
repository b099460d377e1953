"""The viewer draws a recording, or says what is missing."""

import pytest

from labbook.export.recording import write
from labbook.export.viewer import ViewerFailed, screenshot, show

pytest.importorskip("rerun")


@pytest.fixture
def recording(synthetic, tmp_path):
    run = synthetic.observe(synthetic.scene(), seed=1, recorded=True)
    return write(run, run.tables["sample"], tmp_path / "a.rrd", name="a", source="1" * 16)


@pytest.mark.render
def test_a_screenshot_shows_the_grains(recording, tmp_path):
    from matplotlib.image import imread

    picture = tmp_path / "pictures" / "a.png"
    screenshot(recording, picture, at=0.0)
    pixels = imread(picture)[..., :3]
    yellow = (pixels[..., 0] > 0.8) & (pixels[..., 1] > 0.75) & (pixels[..., 2] < 0.35)
    violet = (pixels[..., 0] < 0.4) & (pixels[..., 1] < 0.25) & (pixels[..., 2] > 0.25) & (pixels[..., 2] < 0.6)
    # Fast grains above the outlet, slow ones around: each at least one in a thousand of all pixels.
    assert yellow.mean() > 1e-3
    assert violet.mean() > 1e-3


def test_without_a_screen_the_error_says_what_to_do(recording, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ViewerFailed, match="--screenshot FILE or --no-open"):
        show([recording])


def test_a_recording_that_is_none_is_an_error(tmp_path):
    broken = tmp_path / "b.rrd"
    broken.write_bytes(b"no recording")
    with pytest.raises(ViewerFailed):
        screenshot(broken, tmp_path / "b.png")
    assert not (tmp_path / "b.png").exists()
