"""The studies that `labbook new` writes: one text, with the parts that each container has of its own."""

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from string import Template

from pydantic import TypeAdapter, ValidationError

from labbook.study.schema import Name


class NotWritten(Exception):
    """The study was not written; the message says why and what to do."""


@dataclass(frozen=True)
class TemplateValues:
    """Parts of a template that depend on the container.

    Args:
        about: Purpose of the study, in a sentence.
        count: Number of grains.
        wall: Name of one of the container's walls.
        start: Value of `fill.kind`.
    """

    about: str
    count: int
    wall: str
    container: str
    sweep: str
    window: str
    reference: str
    start: str = "dense"


def _outlets(widths: str, narrow: str, example: str) -> str:
    return f"""\
# Every combination of these values is a point. Keys under `zip` vary together; `points` lists points one by one.
# Outlets narrower than five diameters often clog.
sweep:
  container.orifice: "[{widths}] mm"
  # contact.friction: [0.3, 0.5]
# points:
#   - {{container.orifice: {narrow} mm{example}}}
"""


def _flow(end: str, stop: str, laws: str) -> str:
    return f"""\
# The flow is taken to be steady from 15 % of the mass discharged until the bed is 1.2 widths high, here at {end} %.
# Runs stop soon after.
# window: {{start: 15 %, end: {end} %}}
# stop: {{discharged: {stop} %, max_time: 60 s, stall: 2 s}}

measure: [flow_rate, packing]
fit: [{laws}]
"""


def _bed(measure: str) -> str:
    return f"""\
# Nothing leaves this container: runs last until stop.max_time, and the bed at rest is what is measured.
stop: {{max_time: 10 ms}}

measure: [{measure}]
"""


_FRICTIONS = """\
# Every combination of these values is a point. Keys under `zip` vary together; `points` lists points one by one.
sweep:
  fill.friction: [0.01, 0.1, 0.5]
# points:
#   - {contact.rolling_friction: 0.1}
"""

KINDS = {
    "wedge-hopper": TemplateValues(
        about="Flow rate of a quasi-2D hopper against the width of its outlet",
        count=1000,
        wall="front",
        container="""\
# `angle`: of the bottom from the vertical; 90 deg is flat. `gap`: distance of the outlet from the left wall; without it
# the outlet is centred.
container: {kind: wedge-hopper, width: 60 mm, height: 200 mm, thickness: 1.01 d, angle: 90 deg, orifice: 24 mm}
""",
        sweep=_outlets("21, 23, 25, 27, 29, 31", "20", ", container.gap: 0 mm"),
        window=_flow("45", "50", "beverloo, janda"),
        reference="beverloo.k: {value: 1.5, error: 0.1}",
    ),
    "cylinder-silo": TemplateValues(
        about="Flow rate of a flat-bottomed cylinder against the diameter of its outlet",
        count=7000,
        wall="side",
        container="""\
# `rotation`: of the bottom after the opening, such as 30 rpm or 0.5 Hz.
container: {kind: cylinder-silo, diameter: 46 mm, height: 200 mm, orifice: 18 mm, rotation: 0 Hz}
""",
        sweep=_outlets("16, 18, 20, 22", "15", ", container.rotation: 0.5 Hz"),
        window=_flow("45", "50", "beverloo_3d, janda_3d"),
        reference="beverloo_3d.k: {value: 1.5, error: 0.1}",
    ),
    "conical-silo": TemplateValues(
        about="Flow rate of a cylinder with a cone against the diameter of its outlet",
        count=3500,
        wall="bottom",
        container="""\
# `angle`: of the cone from the vertical. A flat bottom is a cylinder-silo.
container: {kind: conical-silo, diameter: 36 mm, height: 200 mm, angle: 45 deg, orifice: 18 mm}
""",
        sweep=_outlets("16, 18, 20, 22", "15", ", container.angle: 30 deg"),
        window=_flow("50", "55", "beverloo_3d, janda_3d"),
        reference="beverloo_3d.k: {value: 1.5, error: 0.1}",
    ),
    "box": TemplateValues(
        about="Packing fraction in a box against the friction while it is filled",
        count=2000,
        wall="bottom",
        container="""\
# A box has no outlet; `lid` closes its top once it is filled.
container: {kind: box, width: 36 mm, depth: 36 mm, height: 120 mm, lid: false}
""",
        sweep=_FRICTIONS,
        window=_bed("packing"),
        reference="packing_fraction: {value: 0.6, error: 0.01}",
        start="rain",
    ),
    "primitives": TemplateValues(
        about="Largest overlap in a bed round an insert against the friction while it is filled",
        count=2000,
        wall="insert",
        container="""\
# Walls one by one: planes (`normal` points to the grains), strips (plates from `start` to `end` in the x-z plane) and
# frustums (round the axis x = y = 0, from the inner edge `lower` to `upper`). Here a box with a plate across it. Grains
# leave below `outlet_plane`, through gaps between the walls.
container:
  kind: primitives
  parts:
    - {name: floor, shape: {kind: plane, point: [0 mm, 0 mm, 0 mm], normal: [0, 0, 1]}}
    - {name: left, shape: {kind: plane, point: [-20 mm, 0 mm, 0 mm], normal: [1, 0, 0]}}
    - {name: right, shape: {kind: plane, point: [20 mm, 0 mm, 0 mm], normal: [-1, 0, 0]}}
    - {name: front, shape: {kind: plane, point: [0 mm, -20 mm, 0 mm], normal: [0, 1, 0]}}
    - {name: back, shape: {kind: plane, point: [0 mm, 20 mm, 0 mm], normal: [0, -1, 0]}}
    - {name: insert, shape: {kind: strip, start: [-8 mm, 15 mm], end: [8 mm, 22 mm]}}
""",
        sweep=_FRICTIONS,
        window=_bed("ledger"),
        reference="max_overlap: {value: 0.01}",
        start="rain",
    ),
}
"""By container."""


def write(name: str, folder: Path, kind: str = "wedge-hopper") -> Path:
    """Write a commented study called `name` to `folder`/`name`.yaml; an existing file is left alone.

    kind: of its container, one of KINDS. Raises NotWritten for a name that a study cannot have, another kind, a file
    that exists and a folder that cannot be written to.
    """
    try:
        TypeAdapter(Name).validate_python(name)
    except ValidationError:
        raise NotWritten(f"{name!r} cannot be a study's name: use letters, digits, - and _, a letter first") from None
    if kind not in KINDS:
        raise NotWritten(f"no container is called {kind}: use one of {', '.join(KINDS)}")
    path = folder / f"{name}.yaml"
    text = files("labbook.study").joinpath("template.yaml").read_text(encoding="utf-8")
    text = Template(text).substitute(vars(KINDS[kind]), name=name, file=path)
    try:
        with open(path, "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise NotWritten(f"{path} exists and is left as it is: choose another name, or remove it") from None
    except OSError as error:
        raise NotWritten(f"{path} cannot be written: {error.strerror}; choose another folder with --folder") from None
    return path
