"""Fillings that end before the bed rests, and those by a stream: on the toy backend."""

# packings of fillings have ids
# pyright: reportArgumentType=false

import numpy as np
import pytest
from labbook_toy import Backend
from toy_lab import arrays, carry_out, study, study_file
from toy_records import outcomes, records
from wrong_study import problems

from labbook.filling import place
from labbook.lab.evaluations import evaluate
from labbook.lab.packings import PackingRecord, load_packing
from labbook.lab.runs import open_run
from labbook.measure import MEASURES
from labbook.plan.demand import PointDemand

pytestmark = pytest.mark.slow
STREAM = "stream: {rate: 40 g/s, low: [-25 mm, -2 mm, 150 mm], high: [25 mm, 2 mm, 180 mm]}"


def asked(folder, fill: str = ""):
    return study(folder, *([f"fill: {fill}"] if fill else []), orifices="[24]", replicates=1, count=100)


def packing(folder):
    (place,) = (folder / "packings").iterdir()
    return PackingRecord.read(place), load_packing(place)


def test_an_outlet_that_is_open_from_the_start_releases_the_grains_as_they_were_placed(tmp_path):
    one = asked(tmp_path, "{kind: rain, until: placed}").change({"container.height": "2 m"})
    summary = carry_out(one, tmp_path / "lab")
    assert summary.done == 1, summary.tally.failed
    record, bed = packing(tmp_path / "lab")
    start = place(record.scene, "rain", 1)
    assert record.duration == 0
    assert record.filling.until == 0
    assert np.array_equal(bed.x[bed.rows(np.arange(100))], start.x)
    assert np.array_equal(bed.v[bed.rows(np.arange(100))], start.v)
    assert not carry_out(one, tmp_path / "lab").tally.ran


def test_the_outlet_opens_at_a_time(tmp_path):
    carry_out(asked(tmp_path, "{kind: dense, until: 20 ms}"), tmp_path / "lab")
    record, _ = packing(tmp_path / "lab")
    assert 0.02 <= record.duration < 0.02 + record.numerics.beat


def test_a_stream_brings_all_grains_before_the_bed_rests(tmp_path):
    one = asked(tmp_path, f"{{kind: stream, {STREAM}}}")
    summary = carry_out(one, tmp_path / "lab")
    assert summary.done == 1, summary.tally.failed
    record, bed = packing(tmp_path / "lab")
    assert len(bed) == 100
    mass = 100 * record.scene.grains.mass
    assert record.duration >= mass / 0.04 - record.numerics.beat, "the first enter at once"
    assert record.filling.stream is not None
    assert "outside" not in records(tmp_path / "lab")


def test_a_stream_that_was_stopped_goes_on_to_the_same_bits(tmp_path):
    """After 50 of the 88 ms in which it brings all grains."""
    short, long = (asked(tmp_path, f"{{kind: stream, max_time: {time}, {STREAM}}}") for time in ("50 ms", "9 s"))
    stopped = carry_out(short, tmp_path / "stopped")
    assert "of 100 grains have entered by 0.05" in stopped.tally.failed[0]
    carry_out(long, tmp_path / "stopped")
    carry_out(long, tmp_path / "alone")
    (one, bed), (other, alone) = packing(tmp_path / "stopped"), packing(tmp_path / "alone")
    assert len(one.sessions) == 2
    assert one.packing_key == other.packing_key
    assert np.array_equal(bed.ids, alone.ids)
    assert np.array_equal(bed.x, alone.x)


@pytest.mark.parametrize("until", ["placed", "20 ms"])
def test_a_stream_goes_on_after_the_opening(tmp_path, until):
    """It brings 0.11 of the 0.1 kg/s that the outlet lets out: no more leaves than has entered, and all in the end."""
    one = asked(tmp_path, f"{{kind: stream, until: {until}, {STREAM}}}").change({"stop.discharged": 1})
    summary = carry_out(one, tmp_path / "lab")
    assert outcomes(summary) == ["finished"], summary.tally.failed
    filled, bed = packing(tmp_path / "lab")
    assert bed.waiting is not None
    assert len(bed) == 100
    assert 0 < (~bed.waiting).sum() < 100
    assert filled.ledger is not None
    assert (filled.ledger.waiting, filled.ledger.lost) == (bed.waiting.sum(), 0)
    (record,) = records(tmp_path / "lab").values()
    record, data = open_run(tmp_path / "lab" / "runs" / record.run_key)
    assert record.ledger is not None
    assert (record.ledger.left, record.ledger.waiting, record.ledger.lost) == (100, 0, 0)
    times = np.sort(data.tables["crossing"]["time"])
    brought = 0.04 * (filled.duration + times + record.numerics.beat) / record.scene.grains.mass
    assert (np.arange(1, 101) <= brought).all()
    assert np.array_equal(np.sort(data.tables["crossing"]["id"]), np.arange(100))
    assert "entered after the opening" in evaluate(MEASURES["residence"], one.window, data).problem


def test_a_run_into_which_a_stream_goes_on_can_be_stopped(tmp_path):
    fill = f"{{kind: stream, until: 20 ms, {STREAM}}}"
    short, long = (
        asked(tmp_path, fill).change({"stop.discharged": 1, "stop.max_time": time}) for time in ("50 ms", "9 s")
    )
    assert outcomes(carry_out(short, tmp_path / "stopped")) == ["time-limit"]
    (record,) = records(tmp_path / "stopped").values()
    assert record.ledger is not None
    assert record.ledger.waiting > 0
    assert not record.ledger.lost
    assert carry_out(long, tmp_path / "stopped").tally.resumed == 1
    carry_out(long, tmp_path / "alone")
    key = record.run_key
    assert arrays(tmp_path / "stopped" / "runs" / key) == arrays(tmp_path / "alone" / "runs" / key)


def test_fillings_that_differ_in_these_keys_have_keys_of_their_own(tmp_path):
    fills = ("", "{until: placed}", "{until: 1 s}", f"{{kind: stream, {STREAM}}}",
             f"{{kind: stream, {STREAM.replace('40 g/s', '50 g/s')}}}")  # fmt: skip
    keys = set()
    for number, fill in enumerate(fills):
        (tmp_path / str(number)).mkdir()
        one = asked(tmp_path / str(number), fill)
        keys.add(PointDemand(one, one.points[0]).run(1).keys(Backend().capabilities).packing)
    assert len(keys) == len(fills)


@pytest.mark.parametrize(
    ("more", "key", "why"),
    [
        ("fill: {kind: stream}", "fill.stream", "this key is missing"),
        (f"fill: {{kind: rain, {STREAM}}}", "fill.stream", "a rain start has no stream"),
        ("fill: {until: placed}\nmeasure: [flow_rate, packing]", "fill.until", "may move when the outlet opens"),
        (f"fill: {{until: 20 ms, kind: stream, {STREAM}}}\nmeasure: [flow_rate, energy]", "fill.until", "some later"),
        (f"fill: {{until: placed, kind: stream, {STREAM}}}\nfeed: {{kind: reinject}}", "fill.until", "enter at once"),
        (f"fill: {{kind: stream, {STREAM.replace('25 mm, 2', '-24 mm, 2')}}}", "fill.stream", "narrower than a grain"),
        ("feed: {kind: rate}", "feed.stream", "this key is missing"),
        (f"feed: {{kind: rate, {STREAM.replace('150 mm', '179 mm')}}}", "feed.stream", "narrower than a grain along z"),
    ],
)
def test_what_cannot_be_is_told_before_anything_runs(tmp_path, more, key, why):
    text = study_file(tmp_path, *more.split("\n")).read_text(encoding="utf-8")
    told = problems(tmp_path, text.replace("measure: [flow_rate]\n", "", "measure" in more))
    assert any(one.key.startswith(key) and why in one.message for one in told), told
