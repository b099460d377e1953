"""The viewer draws a recording, or says what is missing."""

import pytest

from labbook.export.recording import RecordedRun, write
from labbook.export.viewer import ViewerFailed, screenshot, show

pytest.importorskip("rerun")


@pytest.fixture
def recording(synthetic, tmp_path):
    run = synthetic.observe(synthetic.scene(), seed=1, recorded=True)
    return write([RecordedRun.of(run, run.tables["sample"], "a")], tmp_path / "a.rrd", "1" * 16)


@pytest.mark.render
def test_a_screenshot_shows_the_grains(recording, tmp_path):
    from matplotlib.image import imread

    picture = tmp_path / "pictures" / "a.png"
    screenshot(recording, picture, at=0.0, size=(600, 700))
    pixels = imread(picture)[..., :3]
    orange = (pixels[..., 0] > pixels[..., 2] + 0.3) & (pixels[..., 1] > pixels[..., 2] + 0.1)
    blue = pixels[..., 2] > pixels[..., 0] + 0.2
    # Layers of both hues: each at least one in a thousand of all pixels.
    assert orange.mean() > 1e-3
    assert blue.mean() > 1e-3
    assert 500 < pixels.shape[1] <= 600


def test_without_a_screen_the_error_says_what_to_do(recording, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(ViewerFailed, match="--screenshot FILE or --no-open"):
        show([recording], 0.1)


def test_a_recording_that_is_none_is_an_error(tmp_path):
    broken = tmp_path / "b.rrd"
    broken.write_bytes(b"no recording")
    with pytest.raises(ViewerFailed):
        screenshot(broken, tmp_path / "b.png")
    assert not (tmp_path / "b.png").exists()
