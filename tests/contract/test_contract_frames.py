"""Frames of films lie at the times that were asked for, within beats too, and change nothing."""

from dataclasses import replace

import numpy as np
import pytest
from platforms import identical, specialised

from labbook.backend import Failed
from labbook.backend.probes import Film, Sample
from labbook.checks.verify.platform import rows_of
from labbook.checks.verify.symmetry import DT

BEATS, STEPS = 3, 250
FIELDS = ("x", "v", "omega")
FILM = Film(every=86.72 * DT, fields=FIELDS)
AT = [0, 87, 173, 260, 347, 434, 520, 607, 694]
"""The steps nearest to multiples of 86.72, in three beats of 250."""


def filmed(silo, beats=BEATS, probes=(FILM,), **further):
    """A member's film (without rows if it is not filmed), its other tables, its state and its checkpoint."""
    with silo.ensemble(probes=(silo.crossing, silo.ledger, *probes), **further) as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(beats)
        tables = {probe: rows_of(table, member) for probe, table in ensemble.drain().items()}
        film = tables.pop(FILM, {})
        return film, tables, ensemble.packing(member), dict(ensemble.checkpoint(member).arrays)


def test_frames_lie_at_the_steps_nearest_to_what_is_asked(silo):
    """Also within beats, and from the opening on."""
    film, *_ = filmed(silo)
    steps, counts = np.unique(film["step"], return_counts=True)
    assert list(steps) == AT
    assert np.allclose(film["time"], film["step"] * DT, rtol=1e-12, atol=0)
    assert np.abs(np.unique(film["time"]) - FILM.every * np.arange(len(AT))).max() <= DT / 2 * (1 + 1e-9)
    assert counts[0] == len(silo.start)


def test_the_first_frame_is_the_start(silo):
    film, *_ = filmed(silo)
    first = {name: column[film["step"] == 0] for name, column in film.items()}
    order = np.argsort(silo.start.ids)
    assert np.array_equal(first["id"], silo.start.ids[order])
    # the state may be kept in single precision, but for positions
    for prefix, array, rounding in (("", silo.start.x, 1e-12), ("v", silo.start.v, silo.rounding)):
        found = np.column_stack([first[prefix + axis] for axis in "xyz"])
        assert np.abs(found - array[order]).max() <= 2 * rounding * np.abs(array).max()


def test_frames_within_beats_are_those_of_shorter_beats(silo):
    """How steps are split into beats changes no bit of the motion: beats of 30 steps end where these frames lie."""
    film, sample = Film(every=30 * DT, fields=FIELDS), Sample(fields=FIELDS)
    with silo.ensemble(probes=(silo.crossing, silo.ledger, film)) as ensemble:
        silo.admit(ensemble)
        ensemble.advance(BEATS)
        found = ensemble.drain()[film]
    short = silo.numerics(steps_per_beat=30)
    with silo.ensemble(numerics=short, probes=(silo.crossing, silo.ledger, sample)) as ensemble:
        ensemble.admit(silo.scene, short, silo.start)
        ensemble.advance(BEATS * STEPS // 30)
        wanted = ensemble.drain()[sample]
    later = {name: column[found["step"] > 0] for name, column in found.items()}
    assert len(wanted["step"])
    assert identical(later, wanted)


@pytest.mark.parametrize(
    "special",
    [
        pytest.param(False, id="shared kernels"),
        # compiled for this test alone; reading a film takes the same lines there
        pytest.param(True, id="kernels of users' runs", marks=pytest.mark.ring),
    ],
)
def test_a_film_changes_no_bit_of_anything_else(silo, special):
    """Neither the motion, nor other tables (the ledger counts rebuilds of lists, too), nor the checkpoint."""
    platform = specialised(silo.platform) if special else None
    _, tables, state, checkpoint = filmed(silo, beats=8, platform=platform)
    _, others, other, theirs = filmed(silo, beats=8, probes=(), platform=platform)
    for probe, table in tables.items():
        assert identical(table, others[probe])
    assert identical(state, other)
    assert len(state) < len(silo.start)
    assert identical(checkpoint, theirs)


def test_a_restored_member_goes_on_with_the_next_frame(silo):
    """Without a gap, and with no frame twice, wherever frames lie: at ends of beats, too."""
    films = FILM, Film(every=STEPS * DT, fields=("x",)), Film(every=STEPS * DT / 2, fields=("x",))
    probes = (silo.crossing, silo.ledger, *films)
    with silo.ensemble(probes=probes) as ensemble:
        silo.admit(ensemble)
        ensemble.advance(4)
        whole = ensemble.drain()
    with silo.ensemble(probes=probes) as ensemble:
        member = silo.admit(ensemble)
        ensemble.advance(2)
        first, checkpoint = ensemble.drain(), ensemble.checkpoint(member)
    with silo.ensemble(probes=probes) as ensemble:
        silo.admit(ensemble, checkpoint)
        ensemble.advance(2)
        second = ensemble.drain()
    for film, beats in zip(films[1:], ([0, 1, 2, 3, 4], np.arange(9) / 2), strict=True):
        assert list(np.unique(whole[film]["step"])) == [beat * STEPS for beat in beats]
    for film in films:
        joined = {name: np.concatenate([first[film][name], second[film][name]]) for name in whole[film]}
        assert identical(joined, whole[film])


def test_members_have_their_own_frames(silo):
    """Of members that began at other times, have another time step, or are not filmed."""
    alone, tables, state, _ = filmed(silo)
    slower = silo.numerics(dt=1.5 * DT)
    with silo.ensemble(probes=(silo.crossing, silo.ledger, FILM)) as ensemble:
        early = silo.admit(ensemble, probes=(silo.crossing, silo.ledger))
        ensemble.advance(1)
        late = silo.admit(ensemble)
        other = ensemble.admit(silo.scene, slower, silo.start)
        ensemble.advance(BEATS)
        found = ensemble.drain()
        assert identical(ensemble.packing(late), state)
    assert not len(rows_of(found[FILM], early)["step"])
    assert identical(rows_of(found[FILM], late), alone)
    for probe, table in tables.items():
        ours = rows_of(found[probe], late)
        # of all members, the one that moves farthest in a step decides how often lists are looked at
        assert identical(*({name: rows[name] for name in rows if name != "rebuilds"} for rows in (ours, table)))
    steps = np.unique(rows_of(found[FILM], other)["step"])
    assert list(steps) == [round(k * 86.72 / 1.5) for k in range(13)]


def test_a_beat_that_fails_leaves_no_frames(silo):
    """The member is back at the beginning of that beat, which others still take with all of their frames."""
    x, v = silo.start.x.copy(), silo.start.v.copy()
    x[23], v[23] = [0.0, 0.0, 0.2], [0.0, 0.0, -3.0]
    # it falls freely, and reaches the limit in the second beat
    limit = 3 + 1.5 * STEPS * DT * silo.scene.gravity
    alone, *_ = filmed(silo)
    with silo.ensemble(probes=(silo.crossing, silo.ledger, FILM)) as ensemble:
        failing = ensemble.admit(silo.scene, silo.numerics(speed_limit=limit), replace(silo.start, x=x, v=v))
        well = silo.admit(ensemble)
        events = ensemble.advance(BEATS)
        found, status = ensemble.drain()[FILM], ensemble.status(failing)
    (event,) = [event for event in events if isinstance(event, Failed)]
    assert (event.member, event.guard, event.grain) == (failing, "speed", 23)
    assert STEPS < event.step <= 2 * STEPS
    assert status.step == STEPS
    assert list(np.unique(rows_of(found, failing)["step"])) == [step for step in AT if step <= STEPS]
    assert identical(rows_of(found, well), alone)
