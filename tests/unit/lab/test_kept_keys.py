"""Keys of all shipped studies stay what they are: a key that changes makes the runs of every user's lab stale.

`tests/unit/lab/kept_keys.json` holds, for each point of each study in `studies` and its folders, the keys of its scene,
of the closed scene in which its packing is made, and of packing and run with seed 1 on each bundled backend. A change
that has to change keys writes the file anew, `python tests/unit/lab/test_kept_keys.py`, with a line in CHANGELOG.md
that says which keys and why.
"""

import json
from pathlib import Path

import pytest

from labbook.backend.registry import load
from labbook.plan.demand import demands
from labbook.study import load as load_study

STUDIES = Path(__file__).parents[3] / "studies"
KEPT = Path(__file__).with_name("kept_keys.json")
BACKENDS = ("numba", "reference", "warp")
DIGITS = 12
"""Leading digits of a key that are kept: enough to see a change, and half of the file."""


def keys(path: Path) -> dict[str, dict[str, list[str]]]:
    """By point: the keys of both scenes, and by backend those of packing and run."""
    capabilities = [load(name).capabilities for name in BACKENDS]
    result = dict[str, dict[str, list[str]]]()
    for demand in demands(load_study(path), 1):
        made = [demand.keys(backend) for backend in capabilities]
        entry = {"scene": [demand.shared.scene_key, demand.shared.closed_key]}
        entry |= {name: [one.packing, one.run] for name, one in zip(BACKENDS, made, strict=True)}
        result[f"{demand.point.index + 1}: {demand.point.label}"] = {
            name: [key[:DIGITS] for key in of] for name, of in entry.items()
        }
    return result


@pytest.mark.parametrize("path", sorted(STUDIES.rglob("*.yaml")), ids=lambda path: path.stem)
def test_the_keys_of_a_study_are_kept(path):
    kept = json.loads(KEPT.read_text())
    assert keys(path) == kept.get(path.stem), f"{path.name}: a key changed; see {KEPT.name} in this module's docstring"


def test_no_study_with_keys_has_vanished():
    assert {path.stem for path in STUDIES.rglob("*.yaml")} == set(json.loads(KEPT.read_text()))


def _write():
    lines = list[str]()
    for path in sorted(STUDIES.rglob("*.yaml")):
        points = [f"  {json.dumps(label)}: {json.dumps(entry)}" for label, entry in keys(path).items()]
        lines.append(f'"{path.stem}": {{\n' + ",\n".join(points) + "\n}")
    KEPT.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    _write()
