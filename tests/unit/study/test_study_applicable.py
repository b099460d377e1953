"""Every measurement, law and reference, in every container and for every kind of grains, through every verb.

Either `plan` refuses it, with file, line, key and remedy, or all that follows works.
"""

import re
from pathlib import Path

import pytest
from toy_lab import labbook

from labbook.fit import LAWS
from labbook.measure import MEASURES
from labbook.measure.outlet import DEFINITIONS

GRAINS = {
    "spheres": "{shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 300}",
    "sizes": "{shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 300, sizes: {smallest: 2 mm}}",
    "kinds": "{shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 300, "
    "kinds: [{name: a, share: 50 %, diameter: 2 mm}, {name: b, share: 50 %, density: 7800 kg/m^3}]}",
    "rods": "{shape: spherocylinder, diameter: 3 mm, length: 6 mm, density: 2500 kg/m^3, count: 200}",
}
GRAINS["sizes"] = GRAINS["sizes"].replace("{smallest", "{kind: uniform, smallest")
CONTAINERS = {
    "layer": "{kind: wedge-hopper, width: 60 mm, height: 300 mm, thickness: 1.1 d, orifice: 24 mm}",
    "slot": "{kind: wedge-hopper, width: 45 mm, height: 300 mm, thickness: 30 mm, angle: 45 deg, orifice: 24 mm}",
    "cylinder": "{kind: cylinder-silo, diameter: 36 mm, height: 300 mm, orifice: 24 mm}",
    "cone": "{kind: conical-silo, diameter: 36 mm, height: 300 mm, angle: 45 deg, orifice: 24 mm}",
    "box": "{kind: box, width: 36 mm, depth: 30 mm, height: 300 mm}",
    "plates": "{kind: primitives, parts: ["
    "{name: floor, shape: {kind: plane, point: [0 mm, 0 mm, 0 mm], normal: [0, 0, 1]}},"
    "{name: left, shape: {kind: plane, point: [-20 mm, 0 mm, 0 mm], normal: [1, 0, 0]}},"
    "{name: right, shape: {kind: plane, point: [20 mm, 0 mm, 0 mm], normal: [-1, 0, 0]}},"
    "{name: front, shape: {kind: plane, point: [0 mm, -10 mm, 0 mm], normal: [0, 1, 0]}},"
    "{name: back, shape: {kind: plane, point: [0 mm, 10 mm, 0 mm], normal: [0, -1, 0]}}]}",
}
FITS = (*LAWS, *DEFINITIONS)
REFERENCES = {
    "flow_rate": "flow_rate: {value: 20 g/s}",
    "packing": "packing.packing_fraction: {value: 0.6}",
    "packing_fraction_2d": "packing.packing_fraction_2d: {value: 0.8}",
    "orifice": "orifice.orifice_v_z: {value: -0.2 m/s}",
    "order": "orifice.orifice_S: {from: 0.2, says: rods line up}",
    "rotation": "rotation.grain_rate: {from: 0.2, says: it turns}",
    "ratio": "flow_ratio.angle: {value: 1}",
    "law": "beverloo.k: {value: 1.4}",
    "law_3d": "beverloo_3d.k: {value: 1.4}",
}
LOST = re.compile(r"Traceback|Error\b(?!:)")
"""Marks of an error that no verb expected."""


def text(container: str, grains: str, measure=(), fit=(), reference=()) -> str:
    outlet = container not in ("box", "plates")
    sweep = 'sweep: {container.orifice: "[21, 24] mm"}\n' if outlet else ""
    references = "".join(f"  {one}\n" for one in reference)
    return (
        "name: all\n"
        f"grains: {GRAINS[grains]}\n"
        "contact: {law: hertz-mindlin, shear_modulus: 2 MPa, poisson_ratio: 0.25, friction: 0.5, restitution: 0.2}\n"
        f"container: {CONTAINERS[container]}\n"
        f"{sweep}"
        "numerics: {dt: 10 us, steps_per_beat: 100}\n"
        "stop: {max_time: 1 s}\n"
        "window: {start: 0.15, end: 0.6}\n"
        "record: {every: 10 ms}\n"
        f"measure: [{', '.join(measure)}]\n"
        f"fit: [{', '.join(fit)}]\n" + (f"reference:\n  source: Someone 2020\n{references}" if references else "")
    )


def accepted(file: Path, lab: Path, key: str, name: str) -> bool:
    """Whether `plan` takes the study; if not, it says where, which key and what would help."""
    planned = labbook("plan", file, "--lab", lab, "--backend", "toy", check=False)
    if planned.exit_code == 0:
        return True
    head = rf"Error: {re.escape(str(file))}:\d+: {re.escape(key)}[^:]*: .*\n    remedy: \w.*"
    assert re.match(head, planned.output), f"{name}: {planned.output}"
    return False


QUICK = {"layer-sizes", "slot-sizes", "cylinder-kinds", "cone-kinds", "box-rods", "plates-spheres"}
"""Combinations for `make test`: every container, every kind of grains. The others are in the ring for their number."""


def combinations():
    for container in CONTAINERS:
        for grains in GRAINS:
            name = f"{container}-{grains}"
            yield pytest.param(container, grains, marks=[] if name in QUICK else [pytest.mark.ring], id=name)


@pytest.mark.slow
@pytest.mark.usefixtures("one_format")
@pytest.mark.parametrize(("container", "grains"), list(combinations()))
def test_plan_refuses_it_or_every_verb_works(tmp_path, container, grains):
    file, lab = tmp_path / "all.yaml", tmp_path / "lab"

    def takes(key: str, name: str, **asked) -> bool:
        file.write_text(text(container, grains, **asked))
        return accepted(file, lab, key, name)

    measures = [name for name in MEASURES if takes("measure", name, measure=[name])]
    together = [name for name in measures if name != "arch"]  # it records contacts at other times than other measures
    always = [name for name in ("flow_rate", "outlet_profiles") if name in measures]
    fits = [name for name in FITS if takes("fit", name, measure=always, fit=[name])]
    said = [
        name
        for name, one in REFERENCES.items()
        if takes("reference", name, measure=together, fit=fits, reference=[one])
    ]
    assert (measures, fits, said) == expected(container, grains)
    for name in measures:  # each by itself
        file.write_text(text(container, grains, [name]))
        assert labbook("run", file, "--lab", lab, "--backend", "toy").exit_code == 0
        assert not LOST.search(labbook("fit", file, "--lab", lab, "--backend", "toy").output)
    file.write_text(text(container, grains, together, fits, [REFERENCES[name] for name in said]))
    for verb, *options in (["run"], ["plan"], ["fit"], ["report"], ["export", "--vtk"], ["view", "--no-open"]):
        done = labbook(verb, file, *options, "--lab", lab, "--backend", "toy")
        assert not LOST.search(done.output), done.output


def expected(container: str, grains: str) -> tuple[list[str], list[str], list[str]]:
    """Measurements, laws and references that mean something there."""
    rods, varied = grains == "rods", grains in ("sizes", "kinds")
    slot, hole = container in ("layer", "slot"), container in ("cylinder", "cone")
    flows = slot or hole
    measures = {"flow_rate": flows, "packing": container != "plates", "outlet_profiles": slot and not rods}
    measures |= dict.fromkeys(("orifice", "contact_stress"), hole and not varied)
    measures |= {"ledger": True, "wall_stress": True, "bulk_stress": True}
    measures["energy"] = flows
    # no container has two outlets, planes, or parts that move
    measures |= {"outlets": False, "planes": False, "composition": flows and varied, "residence": flows}
    measures |= {"clogging": flows, "arch": flows and not rods, "part_forces": False, "velocities": flows}
    fits = dict.fromkeys(("beverloo", "janda"), slot) | dict.fromkeys(("beverloo_3d", "janda_3d"), hole)
    fits |= dict.fromkeys(("power", "exponential"), slot or hole)
    fits |= dict.fromkeys(DEFINITIONS, measures["outlet_profiles"])
    said = {"flow_rate": flows, "packing": measures["packing"], "orifice": measures["orifice"], "ratio": True}
    said |= {"packing_fraction_2d": container == "layer" and not rods, "order": measures["orifice"] and rods}
    said |= {"rotation": container == "cylinder", "law": slot, "law_3d": hole}
    return (
        [name for name in MEASURES if measures[name]],
        [name for name in FITS if fits[name]],
        [name for name in REFERENCES if said[name]],
    )


@pytest.mark.slow
@pytest.mark.usefixtures("one_format")
def test_a_source_with_dollars_is_no_formula(tmp_path):
    """Broken mathtext in what an author wrote stands in figures as it was written."""
    file, lab = tmp_path / "all.yaml", tmp_path / "lab"
    said = ["flow_rate: {value: 20 g/s}", "beverloo.C_particle: {value: 0.6}", "beverloo.k: {value: 1.4}"]
    asked = text("layer", "spheres", ["flow_rate"], ["beverloo"], said)
    file.write_text(
        asked.replace("source: Someone 2020", "source: '$\\frac{ \\x$'").replace("[21, 24]", "[18, 21, 24]")
    )
    for verb in ("run", "report"):
        labbook(verb, file, "--lab", lab, "--backend", "toy")
