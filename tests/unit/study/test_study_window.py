"""Where windows and runs end if a study does not say so."""

import pytest
from toy_lab import WINDOW, labbook, study_file

from labbook.filling.bed import discharged_at, expected_bed_height
from labbook.study import StudyError, load
from labbook.study.pilot import pilot


def asked(folder, *more: str, count=1000, **changes):
    """A study of a hopper 60 mm wide that leaves its window out; 1000 grains of 3 mm stand 2.36 widths high in it."""
    path = study_file(folder, *more, count=count, **changes)
    path.write_text(path.read_text().replace(f"{WINDOW}\n", ""))
    return load(path)


def test_it_ends_where_the_bed_is_as_high_as_1_2_widths(tmp_path):
    made = asked(tmp_path)
    scene = made.points[0].scene
    height = expected_bed_height(scene)
    assert height is not None
    assert height == pytest.approx(1000 * scene.grains.volume / 0.55 / (0.06 * 0.00303))
    # a flat bottom: the bed sinks in proportion
    assert 1 - 1.2 * 0.06 / height == pytest.approx(discharged_at(scene, 1.2 * 0.06))
    assert 0.45 < 1 - 1.2 * 0.06 / height < 0.5
    assert (made.window.start, made.window.end, made.stop.discharged) == (0.15, 0.45, 0.5)


def test_what_has_left_a_hopper_is_counted_by_volume(tmp_path):
    made = asked(tmp_path, count=1000)
    steep = made.change({"container.angle": "30 deg"}).points[0].scene
    half = expected_bed_height(steep.model_copy(update={"grains": steep.grains.model_copy(update={"count": 500})}))
    assert half is not None
    assert discharged_at(steep, half) == pytest.approx(0.5)


@pytest.mark.parametrize(("count", "end"), [(200, 0.3), (750, 0.3), (1000, 0.45), (3000, 0.6)])
def test_it_ends_neither_too_early_nor_late(tmp_path, count, end):
    assert asked(tmp_path, count=count).window.end == end


def test_all_points_have_that_of_the_lowest_bed(tmp_path):
    path = study_file(tmp_path, count=1000)
    text = path.read_text().replace(f"{WINDOW}\n", "").replace("orifice: 24 mm}", "orifice: 24 mm}\nfill: {kind: gas}")
    path.write_text(text.replace('container.orifice: "[18, 24] mm"', "grains.count: [1000, 1300, 2000]"))
    assert load(path).window.end == 0.45


@pytest.mark.parametrize(
    ("more", "ends"),
    [
        ("window: {end: 0.7}", (0.15, 0.7, 0.75)),
        ("window: {start: 0.2}", (0.2, 0.45, 0.5)),
        ("window: {start: auto}", (0.0, 0.45, 0.5)),
        ("stop: {discharged: 0.4}", (0.15, 0.4, 0.4)),
        ("stop: {discharged: 1}", (0.15, 0.45, 1.0)),
        ("window: {end: 1}", (0.15, 1.0, 1.0)),
    ],
)
def test_what_is_stated_stays(tmp_path, more, ends):
    made = asked(tmp_path, more)
    assert (made.window.start, made.window.end, made.stop.discharged) == ends


def test_a_start_that_comes_after_it_is_named(tmp_path):
    with pytest.raises(StudyError, match=r"window.end: the window starts at 0.5, but its default end is 0.45"):
        asked(tmp_path, "window: {start: 0.5}")


@pytest.mark.parametrize("more", [(), ("window: {start: auto}",)])
def test_a_pilot_has_the_window_of_its_study(tmp_path, more):
    made = asked(tmp_path, *more, orifices="[18, 21, 24]")
    assert pilot(made).window == made.window


def test_a_start_may_be_left_to_the_flow(tmp_path):
    made = asked(tmp_path, "window: {start: auto}")
    assert made.window.auto
    assert made.change({"window.start": 0}).window != made.window
    with pytest.raises(StudyError, match=r"window.after: the window is stated by mass and by time"):
        made.change({"window.after": "1 s", "window.until": "2 s"})
    with pytest.raises(StudyError, match=r"write a number in \[0, 1\] or auto"):
        made.change({"window.start": "early"})


def test_a_fed_bed_has_no_start_up_to_be_found(tmp_path):
    with pytest.raises(StudyError, match=r"window.start: auto finds the start-up of a discharge.*\n.*such as 0.5"):
        asked(tmp_path, "feed: {kind: reinject}", "window: {start: auto}")


def test_a_low_bed_is_warned_of_unless_the_window_is_stated(tmp_path):
    asked(tmp_path, count=400)
    said = labbook("plan", tmp_path / "toy.yaml", "--lab", tmp_path / "lab", "--backend", "toy").output
    assert "Flow rates from 0.15 to 0.3 of the mass discharged" in said
    assert "the bed is less than 1.2 widths high before the window ends, at 30 % discharged" in " ".join(said.split())
    assert "remedy: use 730 grains or more" in said
    enough = asked(tmp_path, count=730)
    assert enough.window.end == 0.3
    assert "widths high" not in labbook("plan", enough.path, "--lab", tmp_path / "lab", "--backend", "toy").output
    stated = study_file(tmp_path, count=400)
    assert "widths high" not in labbook("plan", stated, "--lab", tmp_path / "lab", "--backend", "toy").output
