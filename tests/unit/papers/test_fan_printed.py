"""Flow rates in the studies of Fan et al. 2023 that follow from the paper's own tables (eqs 12, 14 and 18)."""

import math
from pathlib import Path

import pytest

from labbook.papers.fan2023.laws import Saturation, centred_flow, eccentric_flow, middle_speed
from labbook.study import Study, load

STUDIES = Path(__file__).parents[3] / "studies"


def reference(study: Study, quantity: str, **at: float) -> float:
    """The first number for a quantity whose place is a part of what is asked."""
    assert study.reference is not None
    asked = {f"container.{name}": pytest.approx(value) for name, value in at.items()}
    found = (
        e for e in study.reference.entries if e.quantity == quantity and all(e.at[name] == asked[name] for name in e.at)
    )
    return next(found).value


def lines(study: Study, said: str) -> list[tuple[dict[str, float], float]]:
    """Where flow rates of a line of the paper are stated, without `container.`, and these."""
    assert study.reference is not None
    entries = [e for e in study.reference.entries if e.quantity == "flow_rate" and e.says.startswith(said)]
    return [({name.removeprefix("container."): float(v) for name, v in e.at.items()}, e.value) for e in entries]


@pytest.mark.parametrize(("name", "count"), [("fan2023-flat-column", 8), ("fan2023-hopper-angle", 20)])
def test_eq_14_follows_from_table_2(name: str, count: int):
    study = load(STUDIES / f"{name}.yaml")
    scene, found = study.points[0].scene, lines(study, "eq 14")
    assert len(found) == count
    for at, flow in found:
        R, angle = at["orifice"] / 2, at.get("angle", math.pi / 2)
        a, b, gamma, phi = (
            reference(study, f"outlet_profiles.{one}", angle=angle) for one in ("a", "b", "gamma", "phi_inf")
        )
        v_c = float(middle_speed(gamma, R, scene.gravity))
        expected = centred_flow(scene.grains.diameter, scene.grains.density, phi, v_c, R, a, b)
        assert flow == pytest.approx(expected, abs=0.5e-4)


def test_eq_18_follows_from_table_3():
    study = load(STUDIES / "fan2023-eccentricity.yaml")
    scene, found = study.points[0].scene, lines(study, "eq 18")
    assert len(found) == 21
    for at, flow in found:
        R, place = at["orifice"] / 2, {"width": at["width"], "gap": at["gap"]}
        curve = {**place, "gap": min(at["gap"], 0.018)}  # tau: one curve from 6 mm on, stated up to 18 mm
        tau1, tau2 = (reference(study, f"outlet_profiles.{one}", **curve) for one in ("tau1", "tau2"))
        delta, epsilon, sigma = (
            [reference(study, f"outlet_profiles.{one}{k}", **place) for k in (1, 2)]
            for one in ("delta", "epsilon", "sigma")
        )
        (velocity, fraction), phi_max = (
            zip(delta, epsilon, sigma, strict=True),
            float(Saturation(0.78, tau1, tau2).at(R)),
        )
        of = scene.grains.diameter, scene.grains.density, scene.gravity
        assert flow == pytest.approx(eccentric_flow(*of, R, phi_max, velocity, fraction), abs=0.7e-4)
