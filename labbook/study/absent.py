"""Words for what labbook does not have, and what to do instead: a table, read where a key or a value is unknown."""

import re
from dataclasses import dataclass
from functools import lru_cache


@dataclass(frozen=True)
class Absent:
    """One thing that labbook does not have.

    at: sections in which the words are looked for, as keys (`container`) or as values of a key (`container.kind`);
    `.` is the top of a study, `walls.*` any wall, `[]` any item of a list. words: in small letters and digits; `[]`
    stands for a list where a single value is needed.
    """

    at: str
    words: str
    says: str
    """Message that names the missing feature."""
    remedy: str
    key: str = ""
    """Required key that the word replaces in other codes; that it is missing is then not reported too."""


_NO_MESH = "a surface from a file is a part of a container"
_SHAPES = (
    "state parts: [{name: hopper, shape: {kind: mesh, file: hopper.stl, unit: mm}}] in a container of kind primitives, "
    "or, for an insert, of any kind"
)
_STREAM = "stream: {rate: 50 g/s, low: [-20 mm, -20 mm, 300 mm], high: [20 mm, 20 mm, 320 mm]}}"
_INFLOW = "new grains enter by the stream of the filling, and grains that have left by a feed"
_FEED = f"use fill: {{kind: stream, until: 1 s, {_STREAM}, which goes on after the opening, or feed: {{kind: rate}}"
_OWN_WALLS = "use container: {kind: primitives, parts: [...]} with planes, strips, frustums and meshes as walls"

_PERIODIC = "only a wedge-hopper or a box can be periodic, and only along y"
_SIDES = "state periodic: y in such a container, in place of its front and back wall"

TABLE = (
    Absent(
        "container container.kind container.parts[] walls.*",
        "stl mesh meshes stlfile meshfile file path obj msh ply vtk step cad facet facets triangles geometry polygon",
        _NO_MESH,
        _SHAPES,
    ),
    Absent(".", "stl mesh meshes stlfile meshfile obj msh ply vtk step cad geometry", _NO_MESH, _SHAPES),
    Absent(
        ". contact contact.law contact.between[] walls.* fill.contact fill.contact.law grains",
        "cohesion cohesive cohesionenergydensity adhesion surfaceenergy surfacetension jkr sjkr sjkr2 dmt bond bonds "
        "bondnumber liquid liquidbridge liquidbridges liquidcontent capillary moisture wet vanderwaals hamaker",
        "there is no cohesion: grains are dry and do not stick",
        "leave it out; results hold for dry grains well above 0.1 mm",
    ),
    Absent(
        ".",
        "fluid gas air water cfd drag interstitial interstitialfluid viscosity buoyancy",
        "there is no fluid: grains move in a vacuum",
        "leave it out; air matters to the flow of grains below about 0.5 mm",
    ),
    Absent(
        ". container",
        "insert inserts obstacle obstacles baffle baffles paddle rotor screw",
        "inserts are parts of a container",
        "state them in container.parts, which every kind of container takes",
    ),
    Absent(
        ". container",
        "outlets orifices holes outlet2 orifice2 secondoutlet secondorifice twooutlets openings",
        "this key is for one outlet",
        f"{_OWN_WALLS}: leave a gap for each outlet, with a part `opens: start` in it, and state outlet_plane; to vary "
        "one outlet, sweep container.orifice",
    ),
    Absent(
        "container.orifice",
        "[]",
        "this key is for one outlet",
        "for a flow rate of each width write sweep: {container.orifice: [...]}; for several outlets at once use kind: "
        "primitives",
    ),
    Absent(
        ". container",
        "gate gates valve stopper plug slide slidegate shutter door opensat opentime",
        "there is no gate: the outlet is closed while the container is filled, and opens when the bed is at rest",
        "leave it out; a part of kind mesh opens at a time (opens: 0.2 s) or moves (moves)",
    ),
    Absent(".", "periodic", _PERIODIC, _SIDES),
    Absent(". container", "boundary boundaries boundaryconditions pbc periodicity", _PERIODIC, _SIDES),
    Absent(
        "reference reference.* reference.*[]",
        "csv file path data table url dat txt excel",
        "a CSV file of measurements is named under reference.file, and no other file is read",
        "write reference: {file: measured.csv}, or each value: flow_rate: [{at: {container.orifice: 30 mm}, value: 57 "
        "g/s}]",
    ),
    Absent(
        "grains.sizes.kind",
        "weibull rosinrammler rrsb rrs gamma powerlaw fractal fuller",
        "there is no such distribution of diameters",
        "use uniform, normal or lognormal, or kind: table with diameters and mass_fractions of some classes",
    ),
    Absent(
        "grains grains.sizes grains.sizes.kind",
        "psd particlesizedistribution sieve sieves histogram discrete distribution cumulative classes bins",
        "a table of sizes has another name",
        'use sizes: {kind: table, diameters: "[1, 2, 3] mm", mass_fractions: [0.2, 0.3, 0.5]}, or number_fractions',
    ),
    Absent(
        "grains.kinds[]",
        "massfraction massfrac mass weight weightfraction fractionbymass",
        "a share by mass has another name",
        "use mass_share",
    ),
    Absent(
        "grains.kinds[] fill grains",
        "layer layers layered layering",
        "layers are those of a stream that fills the container",
        "use fill: {kind: stream, stream: {rate: ..., low: ..., high: ..., layers: [a, b]}} with the names of kinds",
    ),
    Absent(
        "feed feed.kind",
        "inflow inlet insertion insertrate insertionrate feedrate massrate massflow source pour",
        _INFLOW,
        _FEED,
    ),
    Absent(
        ".",
        "inflow inlet insertion insertrate insertionrate feedrate massrate factory generator",
        _INFLOW,
        _FEED,
    ),
    Absent(
        "fill fill.kind",
        "rate insertrate insertionrate fillrate massrate pour pouring batch batches velocity source nozzle",
        "a rate belongs to a filling by a stream",
        f"use fill: {{kind: stream, {_STREAM}",
    ),
    Absent(
        "fill fill.kind",
        "path dump restart restartfile data positions packing packingfile initial initialstate",
        "a start from a file has another name",
        "use fill: {kind: file, file: grains.csv}, with a CSV file, a text dump or a data file beside the study",
    ),
    Absent(
        "contact fill.contact numerics",
        "collisiontime tc collisionduration contactduration",
        "a collision time has another name",
        "use contact.contact_time of the law linear",
        key="normal_stiffness",
    ),
    Absent(
        "contact fill.contact numerics",
        "maxoverlap maximumoverlap wishedoverlap targetoverlap",
        "an overlap has another name",
        "use contact.largest_overlap with contact.impact_speed of the law linear; `labbook plan` warns of grains too "
        "soft for their bed",
        key="normal_stiffness",
    ),
    Absent(
        "gravity",
        "[]",
        "gravity always acts along -z",
        "to incline gravity, incline the walls (kind: primitives)",
    ),
    Absent(
        ". container",
        "gravitydirection gravityvector tilt tiltangle inclination",
        "gravity always acts along -z",
        "incline the walls instead (kind: primitives)",
    ),
    Absent(
        "contact.rolling_model fill.contact.rolling_model",
        "epsd2 epsd3",
        "there is no epsd2, whose spring is k_r = k_t R^2 and which has no dashpot",
        "use epsd with its own spring, 2.25 k_n mu_r^2 R^2 (rolling_stiffness), and its dashpot (rolling_damping): "
        "without a dashpot beds rest late or never",
    ),
    Absent(
        "grains.shape",
        "clumps multisphere polyhedron polyhedra superquadric superellipsoid ellipsoid cylinder cylinders cube "
        "cubes tetrahedron disk disc bondedsphere",
        "there are no grains of this shape",
        "use spherocylinder for long grains, clump for other shapes by spheres, or sphere with rolling_friction for "
        "angular ones",
    ),
    Absent(
        "grains",
        "clump clumps spheres multisphere template templates",
        "grains put together from spheres have keys of their own",
        "use shape: clump, with the centres and diameters of its spheres",
    ),
    Absent(
        "measure",
        "wallforce wallforces wallpressure pressure force forces torque janssen",
        "forces on walls have another name",
        "use wall_stress, or bulk_stress and contact_stress for the stress within the bed",
    ),
    Absent(
        "measure",
        "clog clogged clogs avalanche avalanches avalanchesize arches jamming",
        "no measure has this name",
        "use clogging, the stops and the grains between them, or arch, the grains that hold a stop",
    ),
    Absent(
        "measure",
        "segregation mixing lacey massbykind kinds species",
        "no measure has this name",
        "use composition, the kinds of the grains that leave and how well the bed is mixed",
    ),
    Absent(
        "measure",
        "residencetime residencetimes rtd tracer tracers age layers",
        "no measure has this name",
        "use residence, the residence times of a fed silo, or map and layers of a batch discharge",
    ),
    Absent(
        "fit",
        "criticalsize nocriticalsize zuriguel thomasdurian thomas avalanche avalanches clogging powerlawtail",
        "laws of avalanches are not named here",
        "add clogging to measure: its laws of D/d are fitted and compared automatically",
    ),
    Absent(
        "fit",
        "janssen hydrostatic vanelclement",
        "laws of the stress on walls are not named here",
        "add wall_stress to measure: three models of Janssen's law are fitted and compared automatically",
    ),
    Absent(
        "fill",
        "lower lowering bottom mobilisation mobilization mobilize lowerbottom piston",
        "the bottom of a container stays where it is",
        "use fill.mobilise: {bottom: 0.1 d, velocity: 1 mm/s}, which moves the surfaces of upright walls up instead",
    ),
    Absent(
        "measure",
        "profile profiles velocityprofile velocity zone zones field fields",
        "there is no profile of the whole bed",
        "use velocities over the outlet and in container.zones, outlet_profiles, orifice, or record for maps",
    ),
)
"""Words of users who come from other codes. The first row that has a word at its place counts."""


def absent(section: str, word: str) -> Absent | None:
    """The row for `word`, an unknown key within the dotted `section`, or an unknown value of the key `section`."""
    section_key = re.sub(r"\[\d+\]", "[]", section) or "."
    section_key = re.sub(r"^(walls|reference)\.[^.[]+", r"\1.*", section_key)
    return _rows().get((section_key, plain(word)))


def plain(word: str) -> str:
    """Spelling of a word in the table: small letters and digits."""
    return word if word == "[]" else re.sub(r"[^a-z0-9]", "", word.lower())


@lru_cache(maxsize=1)
def _rows() -> dict[tuple[str, str], Absent]:
    rows: dict[tuple[str, str], Absent] = {}
    for row in TABLE:
        for section in row.at.split():
            for word in row.words.split():
                rows.setdefault((section, word), row)
    return rows
