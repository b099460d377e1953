"""The linear law by a contact time, or by the largest overlap: against the motion of two grains."""

import math
from typing import Any

import pytest
from scipy.integrate import solve_ivp

import labbook
from labbook.lab.identity import scene_key
from labbook.plan.derived import derived
from labbook.scene import LinearSpringDashpot
from labbook.study import StudyError

STUDY: dict[str, Any] = {
    "name": "x",
    "grains": {"shape": "sphere", "diameter": "3 mm", "density": "2500 kg/m^3", "count": 600},
    "contact": {"law": "linear", "friction": 0.5, "restitution": 0.4},
    "container": {"kind": "cylinder-silo", "diameter": "30 mm", "height": "140 mm", "orifice": "18 mm"},
}
MASS = 2500 * math.pi / 6 * 3e-3**3
MIXED = {"kind": "table", "diameters": "[1.5, 3] mm", "number_fractions": [0.5, 0.5]}


def _study(*, sizes=None, **contact):
    grains = {**STUDY["grains"], "sizes": sizes} if sizes else STUDY["grains"]
    return labbook.define({**STUDY, "grains": grains, "contact": {**STUDY["contact"], **contact}})


def _law(**stated) -> LinearSpringDashpot:
    law = _study(**stated).points[0].scene.contact
    assert isinstance(law, LinearSpringDashpot)
    return law


def _collision(k: float, mass: float, ratio: float, speed: float) -> tuple[float, float, float]:
    """Duration, restitution and largest overlap of two grains of the same mass whose spring and dashpot may pull."""
    half = mass / 2

    def slope(_, state):
        return [state[1], -(k * state[0] + 2 * ratio * math.sqrt(k * half) * state[1]) / half]

    def apart(t, state):
        return state[0] if t > 0 else 1.0

    apart.terminal, apart.direction = True, -1  # type: ignore[attr-defined]
    end = solve_ivp(slope, (0, 1), [0.0, speed], events=apart, rtol=1e-10, atol=1e-14, max_step=0.01)
    return float(end.t_events[0][0]), -float(end.y_events[0][0][1]) / speed, float(end.y[0].max())


def test_two_grains_are_in_contact_for_the_stated_time():
    law = _law(contact_time="1 ms", damping="textbook")
    duration, restitution, _ = _collision(law.normal_stiffness, MASS, law.damping_ratio(0.4), 1.0)
    assert duration == pytest.approx(1e-3, rel=1e-7)
    assert restitution == pytest.approx(0.4, rel=1e-7)


def test_two_grains_overlap_by_the_stated_length_at_the_stated_speed():
    law = _law(largest_overlap="0.01 d", impact_speed="1.5 m/s")
    duration, _, _ = _collision(law.normal_stiffness, MASS, 0.0, 1.5)
    assert duration == pytest.approx(math.pi * math.sqrt(MASS / 2 / law.normal_stiffness), rel=1e-7)
    # at the deepest point, half of the time, all energy is in the spring
    assert law.normal_stiffness * 3e-5**2 / 2 == pytest.approx(MASS / 2 * 1.5**2 / 2, rel=1e-9)


def test_of_unlike_grains_the_lightest_collide_shortest_and_the_heaviest_overlap_most():
    light = MASS / 8
    by_time = _law(sizes=MIXED, contact_time="0.1 ms").normal_stiffness
    assert by_time == pytest.approx(light * (math.pi**2 + math.log(0.4) ** 2) / 2 / 1e-4**2, rel=1e-9)
    by_overlap = _law(sizes=MIXED, largest_overlap="30 um", impact_speed="1 m/s").normal_stiffness
    assert by_overlap == pytest.approx(MASS / 2 / 3e-5**2, rel=1e-9)


def test_runs_have_the_key_of_the_stiffness_however_it_is_stated():
    by_time = _study(contact_time="0.2 ms").points[0].scene
    assert isinstance(by_time.contact, LinearSpringDashpot)
    directly = _study(normal_stiffness=f"{by_time.contact.normal_stiffness!r} N/m").points[0].scene
    assert scene_key(by_time) == scene_key(directly)
    assert by_time.model_dump() == directly.model_dump()
    assert type(by_time).model_validate_json(by_time.model_dump_json()) == directly


def test_a_sweep_of_the_contact_time_is_labelled_and_planned():
    study = labbook.define({**STUDY, "contact": {**STUDY["contact"], "contact_time": "1 ms"}}).change(
        {"sweep": {"contact.contact_time": "[0.1, 0.2] ms"}}
    )
    assert [point.at for point in study.points] == [{"contact.contact_time": 1e-4}, {"contact.contact_time": 2e-4}]
    lines = derived(study.points)
    assert len(lines) == 2
    stiff = MASS * (math.pi**2 + math.log(0.4) ** 2) / 2 / 1e-4**2
    assert next(iter(lines)).startswith(f"Stiffness: k_n = {stiff:.4g} N/m, by a contact time of 0.1 ms")


def test_the_filling_states_its_own_law_in_the_same_way():
    fill = {"contact": {"law": "linear", "contact_time": "1 ms", "restitution": 0.2}}
    law = labbook.define(
        {**STUDY, "contact": {**STUDY["contact"], "normal_stiffness": "2000 N/m"}, "fill": fill}
    ).points[0].fill.contact  # fmt: skip
    assert isinstance(law, LinearSpringDashpot)
    assert law.normal_stiffness == pytest.approx(MASS * (math.pi**2 + math.log(0.2) ** 2) / 2 / 1e-3**2, rel=1e-9)


def test_sizes_are_planned_with_their_means():
    study = _study(sizes=MIXED, normal_stiffness="1e4 N/m")
    (line,) = derived(study.points)
    # by mass 8 of 9 parts are of 3 mm; the mean volume is 9/16 of that of 3 mm
    assert line == (
        "Sizes: 1.5 to 3 mm, mean 2.25 mm by number and 2.83 mm by mass; d = 3 mm is the largest, "
        "d* = 2.48 mm that of the mean volume"
    )


@pytest.mark.parametrize(
    ("stated", "key", "message"),
    [
        ({"normal_stiffness": "1 N/m", "contact_time": "1 ms"}, "contact.contact_time", "stated twice"),
        (
            {"contact_time": "1 ms", "largest_overlap": "1 um", "impact_speed": "1 m/s"},
            "contact.contact_time",
            "stated twice",
        ),
        ({"contact_time": "1 ms", "impact_speed": "1 m/s"}, "contact.impact_speed", "does not depend on the speed"),
        ({"largest_overlap": "1 um"}, "contact.impact_speed", "follows from the speed"),
        ({"impact_speed": "1 m/s"}, "contact.largest_overlap", "follows from the speed"),
        ({"largest_overlap": "1 um", "impact_speed": "0 m/s"}, "contact.impact_speed", "above 0"),
        ({"contact_time": "1 mm"}, "contact.contact_time", "a quantity in s is needed"),
        ({"law": "hertz-mindlin", "contact_time": "1 ms"}, "contact.contact_time", "law: linear"),
    ],
)
def test_what_is_not_one_way_is_refused(stated, key, message):
    with pytest.raises(StudyError) as caught:
        _study(**stated)
    assert message in next(problem.message for problem in caught.value.problems if problem.key == key)
