"""The keys of a study as types. Generated from the models by `labbook.study.static`; do not edit.

All values may be of any type: they are checked when the study is made. Types only list the known keys and choices.
"""
# fmt: off
# ruff: noqa: E501

from collections.abc import Mapping, Sequence
from typing import Literal, TypeAlias, TypedDict

Swept = TypedDict("Swept", {
    "grains.shape": object, "grains.diameter": object, "grains.density": object, "grains.count": object,
    "grains.sizes.kind": object, "grains.sizes.smallest": object, "grains.sizes.mean": object,
    "grains.sizes.deviation": object, "grains.sizes.median": object, "grains.sizes.spread": object,
    "grains.sizes.by": object, "grains.length": object, "contact.law": object, "contact.friction": object,
    "contact.rolling_friction": object, "contact.restitution": object, "contact.damping": object,
    "contact.rolling": object, "contact.rolling_model": object, "contact.rolling_stiffness": object,
    "contact.rolling_damping": object, "contact.shear_modulus": object, "contact.poisson_ratio": object,
    "contact.tangential_damping": object, "contact.normal_damping": object, "contact.youngs_modulus": object,
    "contact.tension": object, "contact.normal_stiffness": object, "contact.tangential_stiffness": object,
    "contact.contact_time": object, "contact.largest_overlap": object, "contact.impact_speed": object,
    "container.kind": object, "container.sink": object, "container.width": object, "container.height": object,
    "container.thickness": object, "container.angle": object, "container.orifice": object,
    "container.lip.radius": object, "container.lip.thickness": object, "container.gap": object,
    "container.periodic": object, "container.diameter": object, "container.rotation": object,
    "container.depth": object, "container.lid": object, "container.outlet_plane": object,
    "walls.all.friction": object, "walls.all.rolling_friction": object, "walls.all.restitution": object,
    "walls.all.youngs_modulus": object, "walls.all.shear_modulus": object, "walls.all.poisson_ratio": object,
    "walls.all.normal_stiffness": object, "gravity": object, "feed.kind": object, "feed.stream.rate": object,
    "feed.stream.every": object, "restart.kind": object, "restart.wait": object, "fill.kind": object,
    "fill.stream.rate": object, "fill.stream.every": object, "fill.until": object, "fill.friction": object,
    "fill.contact.law": object, "fill.contact.friction": object, "fill.contact.rolling_friction": object,
    "fill.contact.restitution": object, "fill.contact.damping": object, "fill.contact.rolling": object,
    "fill.contact.rolling_model": object, "fill.contact.rolling_stiffness": object,
    "fill.contact.rolling_damping": object, "fill.contact.shear_modulus": object,
    "fill.contact.poisson_ratio": object, "fill.contact.tangential_damping": object,
    "fill.contact.normal_damping": object, "fill.contact.youngs_modulus": object, "fill.contact.tension": object,
    "fill.contact.normal_stiffness": object, "fill.contact.tangential_stiffness": object,
    "fill.contact.contact_time": object, "fill.contact.largest_overlap": object,
    "fill.contact.impact_speed": object, "fill.numerics.dt": object, "fill.numerics.precision": object,
    "fill.numerics.integrator": object, "fill.numerics.skin": object, "fill.numerics.steps_per_beat": object,
    "fill.numerics.stiffness_scale": object, "fill.numerics.speed_limit": object,
    "fill.numerics.overlap_limit": object, "fill.settled_below": object, "fill.moving": object,
    "fill.surface_motion": object, "fill.mobilise.bottom": object, "fill.mobilise.velocity": object,
    "fill.max_time": object, "numerics.dt": object, "numerics.precision": object, "numerics.integrator": object,
    "numerics.skin": object, "numerics.steps_per_beat": object, "numerics.stiffness_scale": object,
    "numerics.speed_limit": object, "numerics.overlap_limit": object,
}, total=False)
"""Dotted keys that a sweep may vary."""


Changed = TypedDict("Changed", {
    "name": object, "about": object, "replicates": object, "discharges_per_bed": object,
    "accuracy.flow_rate": object, "accuracy.clogging": object, "accuracy.max_replicates": object,
    "accuracy.calibration": object, "accuracy.numerics": object, "accuracy.count_suspect": object,
    "measure": object, "fit": object, "window.start": object, "window.end": object, "window.after": object,
    "window.until": object, "window.gap": object, "window.moment": object, "window.interval": object,
    "window.layer": object, "stop.discharged": object, "stop.max_time": object, "stop.stall": object,
    "stop.still": object, "stop.fill_height": object, "record.every": object, "record.replicates": object,
    "record.film": object, "grains.shape": object, "grains.diameter": object, "grains.density": object,
    "grains.count": object, "grains.sizes.kind": object, "grains.sizes.smallest": object,
    "grains.sizes.mean": object, "grains.sizes.deviation": object, "grains.sizes.median": object,
    "grains.sizes.spread": object, "grains.sizes.by": object, "grains.sizes.diameters": object,
    "grains.sizes.number_fractions": object, "grains.sizes.mass_fractions": object, "grains.length": object,
    "grains.centres": object, "grains.diameters": object, "contact.law": object, "contact.friction": object,
    "contact.rolling_friction": object, "contact.restitution": object, "contact.damping": object,
    "contact.rolling": object, "contact.rolling_model": object, "contact.rolling_stiffness": object,
    "contact.rolling_damping": object, "contact.shear_modulus": object, "contact.poisson_ratio": object,
    "contact.tangential_damping": object, "contact.normal_damping": object, "contact.youngs_modulus": object,
    "contact.tension": object, "contact.normal_stiffness": object, "contact.tangential_stiffness": object,
    "contact.contact_time": object, "contact.largest_overlap": object, "contact.impact_speed": object,
    "container.kind": object, "container.sink": object, "container.width": object, "container.height": object,
    "container.thickness": object, "container.angle": object, "container.orifice": object,
    "container.lip.radius": object, "container.lip.thickness": object, "container.gap": object,
    "container.periodic": object, "container.diameter": object, "container.rotation": object,
    "container.depth": object, "container.lid": object, "container.outlet_plane": object,
    "walls.all.friction": object, "walls.all.rolling_friction": object, "walls.all.restitution": object,
    "walls.all.youngs_modulus": object, "walls.all.shear_modulus": object, "walls.all.poisson_ratio": object,
    "walls.all.normal_stiffness": object, "gravity": object, "feed.kind": object, "feed.stream.rate": object,
    "feed.stream.low": object, "feed.stream.high": object, "feed.stream.velocity": object,
    "feed.stream.every": object, "feed.stream.layers": object, "restart.kind": object, "restart.wait": object,
    "fill.kind": object, "fill.file": object, "fill.shift": object, "fill.stream.rate": object,
    "fill.stream.low": object, "fill.stream.high": object, "fill.stream.velocity": object,
    "fill.stream.every": object, "fill.stream.layers": object, "fill.until": object, "fill.friction": object,
    "fill.contact.law": object, "fill.contact.friction": object, "fill.contact.rolling_friction": object,
    "fill.contact.restitution": object, "fill.contact.damping": object, "fill.contact.rolling": object,
    "fill.contact.rolling_model": object, "fill.contact.rolling_stiffness": object,
    "fill.contact.rolling_damping": object, "fill.contact.shear_modulus": object,
    "fill.contact.poisson_ratio": object, "fill.contact.tangential_damping": object,
    "fill.contact.normal_damping": object, "fill.contact.youngs_modulus": object, "fill.contact.tension": object,
    "fill.contact.normal_stiffness": object, "fill.contact.tangential_stiffness": object,
    "fill.contact.contact_time": object, "fill.contact.largest_overlap": object,
    "fill.contact.impact_speed": object, "fill.numerics.dt": object, "fill.numerics.precision": object,
    "fill.numerics.integrator": object, "fill.numerics.skin": object, "fill.numerics.steps_per_beat": object,
    "fill.numerics.stiffness_scale": object, "fill.numerics.speed_limit": object,
    "fill.numerics.overlap_limit": object, "fill.settled_below": object, "fill.moving": object,
    "fill.surface_motion": object, "fill.mobilise.bottom": object, "fill.mobilise.velocity": object,
    "fill.max_time": object, "numerics.dt": object, "numerics.precision": object, "numerics.integrator": object,
    "numerics.skin": object, "numerics.steps_per_beat": object, "numerics.stiffness_scale": object,
    "numerics.speed_limit": object, "numerics.overlap_limit": object, "sweep.grains.shape": object,
    "sweep.grains.diameter": object, "sweep.grains.density": object, "sweep.grains.count": object,
    "sweep.grains.sizes.kind": object, "sweep.grains.sizes.smallest": object, "sweep.grains.sizes.mean": object,
    "sweep.grains.sizes.deviation": object, "sweep.grains.sizes.median": object,
    "sweep.grains.sizes.spread": object, "sweep.grains.sizes.by": object, "sweep.grains.length": object,
    "sweep.contact.law": object, "sweep.contact.friction": object, "sweep.contact.rolling_friction": object,
    "sweep.contact.restitution": object, "sweep.contact.damping": object, "sweep.contact.rolling": object,
    "sweep.contact.rolling_model": object, "sweep.contact.rolling_stiffness": object,
    "sweep.contact.rolling_damping": object, "sweep.contact.shear_modulus": object,
    "sweep.contact.poisson_ratio": object, "sweep.contact.tangential_damping": object,
    "sweep.contact.normal_damping": object, "sweep.contact.youngs_modulus": object, "sweep.contact.tension": object,
    "sweep.contact.normal_stiffness": object, "sweep.contact.tangential_stiffness": object,
    "sweep.contact.contact_time": object, "sweep.contact.largest_overlap": object,
    "sweep.contact.impact_speed": object, "sweep.container.kind": object, "sweep.container.sink": object,
    "sweep.container.width": object, "sweep.container.height": object, "sweep.container.thickness": object,
    "sweep.container.angle": object, "sweep.container.orifice": object, "sweep.container.lip.radius": object,
    "sweep.container.lip.thickness": object, "sweep.container.gap": object, "sweep.container.periodic": object,
    "sweep.container.diameter": object, "sweep.container.rotation": object, "sweep.container.depth": object,
    "sweep.container.lid": object, "sweep.container.outlet_plane": object, "sweep.walls.all.friction": object,
    "sweep.walls.all.rolling_friction": object, "sweep.walls.all.restitution": object,
    "sweep.walls.all.youngs_modulus": object, "sweep.walls.all.shear_modulus": object,
    "sweep.walls.all.poisson_ratio": object, "sweep.walls.all.normal_stiffness": object, "sweep.gravity": object,
    "sweep.feed.kind": object, "sweep.feed.stream.rate": object, "sweep.feed.stream.every": object,
    "sweep.restart.kind": object, "sweep.restart.wait": object, "sweep.fill.kind": object,
    "sweep.fill.stream.rate": object, "sweep.fill.stream.every": object, "sweep.fill.until": object,
    "sweep.fill.friction": object, "sweep.fill.contact.law": object, "sweep.fill.contact.friction": object,
    "sweep.fill.contact.rolling_friction": object, "sweep.fill.contact.restitution": object,
    "sweep.fill.contact.damping": object, "sweep.fill.contact.rolling": object,
    "sweep.fill.contact.rolling_model": object, "sweep.fill.contact.rolling_stiffness": object,
    "sweep.fill.contact.rolling_damping": object, "sweep.fill.contact.shear_modulus": object,
    "sweep.fill.contact.poisson_ratio": object, "sweep.fill.contact.tangential_damping": object,
    "sweep.fill.contact.normal_damping": object, "sweep.fill.contact.youngs_modulus": object,
    "sweep.fill.contact.tension": object, "sweep.fill.contact.normal_stiffness": object,
    "sweep.fill.contact.tangential_stiffness": object, "sweep.fill.contact.contact_time": object,
    "sweep.fill.contact.largest_overlap": object, "sweep.fill.contact.impact_speed": object,
    "sweep.fill.numerics.dt": object, "sweep.fill.numerics.precision": object,
    "sweep.fill.numerics.integrator": object, "sweep.fill.numerics.skin": object,
    "sweep.fill.numerics.steps_per_beat": object, "sweep.fill.numerics.stiffness_scale": object,
    "sweep.fill.numerics.speed_limit": object, "sweep.fill.numerics.overlap_limit": object,
    "sweep.fill.settled_below": object, "sweep.fill.moving": object, "sweep.fill.surface_motion": object,
    "sweep.fill.mobilise.bottom": object, "sweep.fill.mobilise.velocity": object, "sweep.fill.max_time": object,
    "sweep.numerics.dt": object, "sweep.numerics.precision": object, "sweep.numerics.integrator": object,
    "sweep.numerics.skin": object, "sweep.numerics.steps_per_beat": object,
    "sweep.numerics.stiffness_scale": object, "sweep.numerics.speed_limit": object,
    "sweep.numerics.overlap_limit": object,
}, total=False)
"""Dotted keys that `Study.change` takes."""


class AccuracyKeys(TypedDict, total=False):
    """Section `accuracy`."""

    flow_rate: object
    """Relative error of the flow rate to reach: bias of the numerics plus half-width of the 95 % interval. labbook
    then chooses numerics that are left out, and the number of replicates; none: `replicates` runs. Range: in (0,
    1)."""
    clogging: object
    """Relative half-width of the 95 % interval of the probability of a stop to reach: replicates are added until
    (1.96/error)² stops were counted, 97 for 20 %; none: `replicates` runs. Range: in (0, 1)."""
    max_replicates: object
    """Largest number of replicates per point, even if the error is not reached. Range: of at least 2."""
    calibration: object
    """Calibration file written by `labbook pilot`; none: STUDY.calibration.json beside the study file, if it
    exists, and the file shipped with labbook."""
    numerics: object
    """Relative margin of the equivalence test between swept numerics; none: no test. Range: in (0, 1)."""
    count_suspect: object
    """Use suspect runs (by their ledger) in means and fits too."""


class WindowKeys(TypedDict, total=False):
    """Section `window`."""

    start: object
    """Discharged mass fraction at which the window opens. `auto`: in each run at the end of its start-up, where the
    flow rate has come within 1 % of its plateau. Range: in [0, 1] or auto."""
    end: object
    """Discharged mass fraction at which the window closes. If left out: where the lowest bed of the study is still
    1.2 container widths high, between 0.3 and 0.6; 0.6 where that height is unknown. Range: in [0, 1]."""
    after: object
    """Time after the opening of the outlet at which the window opens, instead of `start` [s]. Range: of at least 0."""
    until: object
    """Time after the opening of the outlet at which the window closes, instead of `end` [s]. Range: above 0."""
    gap: object
    """A longer time without a leaving grain is left out of the flow rate, and reported [s]. Range: above 0."""
    moment: object
    """Time over which maps at three instants of the window are averaged, and at most between two frames of
    `contact_stress` [s]. Range: above 0."""
    interval: object
    """Time between the two velocities whose difference is the acceleration above the outlet [s]. Range: above 0."""
    layer: object
    """Height of the layer above the outlet over which fields are averaged [m]. Range: above 0."""


class StopKeys(TypedDict, total=False):
    """Section `stop`."""

    discharged: object
    """Stop at this discharged mass fraction, at least `window.end`; if left out: `window.end` + 0.05. Range: in (0,
    1]."""
    max_time: object
    """Stop at this time after the opening of the outlet; if left out, not before `window.until` [s]. Range: above
    0."""
    stall: object
    """Time without a leaving grain after which a run is clogged [s]. Range: above 0."""
    still: object
    """End a run as clogged once no grain has left for 20 `√(d*/g)`, and none within 2 D of the outlet is faster
    than 0.01 `√(g d*)`."""
    fill_height: object
    """Stop when the bed of a flat-bottomed silo has fallen to this height; none: no such stop [m]. Range: above 0."""


class RecordKeys(TypedDict, total=False):
    """Section `record`."""

    every: object
    """Time between two recorded frames, to the nearest time step. The first frame is at the opening [s]. Range:
    above 0."""
    replicates: object
    """Number of replicates of each point that are recorded; of each bed the first discharge. Range: of at least 1."""
    film: object
    """Make a film of every recorded run in LAB/films once the study has run."""


class GrainsSizesKeys(TypedDict, total=False):
    """Section `grains.sizes`."""

    kind: Literal["uniform", "normal", "lognormal", "table", "list"] | object
    """`uniform`: Uniform number distribution of diameters from `smallest` to d; `normal`: Normal number
    distribution of diameters, cut at d and symmetrically below the mean; `lognormal`: Log-normal distribution of
    diameters, cut at `smallest` and at d; `table`: Classes of grains of one diameter each, with the number or mass
    fraction of each; `list`: Measured diameters, all equally frequent; as many grains as diameters have exactly
    these."""
    smallest: object
    """Smallest diameter, from d/10 to below d [m]. Range: above 0."""
    mean: object
    """Mean diameter, below d [m]. Range: above 0."""
    deviation: object
    """Standard deviation of the diameters before the cut [m]. Range: above 0."""
    median: object
    """Median diameter before the cut, between `smallest` and d [m]. Range: above 0."""
    spread: object
    """Standard deviation of the logarithm of the diameter before the cut, ln of the geometric standard deviation.
    Range: in (0, 2]."""
    by: Literal["number", "mass"] | object
    """Weight of the distribution: `number` of grains, or `mass`, as sieves measure it."""
    diameters: object
    """kind: table: Diameters of the classes, from d/10 to d; the largest is d [m].

    kind: list: Diameters, from d/10 to d; the largest is d [m]."""
    number_fractions: object
    """Number fraction of each class; all add up to 1."""
    mass_fractions: object
    """Mass fraction of each class, instead of `number_fractions`; all add up to 1."""


class GrainsKindsKeys(TypedDict, total=False):
    """Section `grains.kinds[]`."""

    name: object
    """Name that `contact.between` refers to: lower-case letters, digits and hyphens."""
    share: object
    """Number fraction of this kind; all shares add up to 1. All kinds state `share`, or all state `mass_share`.
    Range: in (0, 1]."""
    mass_share: object
    """Mass fraction of this kind, instead of `share`; all add up to 1. Range: in (0, 1]."""
    diameter: object
    """Diameter of all grains of this kind, at most d; none: from `grains.sizes`, or d [m]. Range: above 0."""
    density: object
    """Density of this kind's material; none: `grains.density` [kg/m^3]. Range: above 0."""
    youngs_modulus: object
    """Young's modulus E of this kind's material, instead of `shear_modulus` [Pa]. Range: above 0."""
    shear_modulus: object
    """Shear modulus G of this kind's material (laws by Hertz); none: as in `contact` [Pa]. Range: above 0."""
    poisson_ratio: object
    """Poisson's ratio ν of this kind's material, only with a modulus; none: as in `contact`. Range: in (-1, 0.5]."""


class GrainsKeys(TypedDict, total=False):
    """Section `grains`."""

    shape: Literal["sphere", "spherocylinder", "clump"] | object
    """`sphere`: Spheres, equal or of several sizes and materials; `spherocylinder`: Equal rods: cylinders with
    hemispheres on both ends; `clump`: Equal rigid clumps of up to eight spheres, which may overlap: any convex or
    concave grain."""
    diameter: object
    """shape: sphere: Diameter d of the largest grains; `d` is a unit of length in all other keys [m]. Range: above
    0.

    shape: spherocylinder: Diameter d; `d` is a unit of length in all other keys [m]. Range: above 0.

    shape: clump: Diameter d of the largest sphere; `d` is a unit of length in all other keys [m]. Range: above 0."""
    density: object
    """Density ρ_p of the grains' material [kg/m^3]. Range: above 0."""
    count: object
    """Number of grains N. Range: of at least 1."""
    length: object
    """Length L from end to end, at least the diameter; an aspect ratio of 3.3 is a length of `3.3 d` [m]. Range:
    above 0."""
    centres: object
    """Centres of the spheres, in any frame, such as `[[-0.4 d, 0 d, 0 d], [0.4 d, 0 d, 0 d]]`; 1 to 8 of them [m]."""
    diameters: object
    """Diameters of the spheres in the order of `centres`, the largest of them d; none: all are d [m]."""
    sizes: GrainsSizesKeys | object
    kinds: Sequence[GrainsKindsKeys | object] | object


class ContactBetweenKeys(TypedDict, total=False):
    """Section `contact.between[]`."""

    friction: object
    """Friction coefficient between these kinds; for one kind named twice also at walls without their own. Range: of
    at least 0."""
    rolling_friction: object
    """Rolling friction coefficient μ_r between these kinds; at walls as for `friction`. Range: of at least 0."""
    restitution: object
    """Coefficient of normal restitution between these kinds, in (0, 1]; at walls as for `friction`. Range: in (0,
    1]."""
    kinds: object
    """Names of the two kinds, from `grains.kinds`."""
    normal_stiffness: object
    """Normal stiffness k_n between these kinds (law linear); at walls as for `friction` [N/m]. Range: above 0."""


class ContactKeys(TypedDict, total=False):
    """Section `contact`."""

    law: Literal["hertz-mindlin", "hertz-printed", "hertz-liggghts", "hertz-lammps", "linear"] | object
    """`hertz-mindlin`: Hertz normal force with Mindlin's friction spring (Fan et al. 2023, eqs 6-8);
    `hertz-printed`: Fan et al. 2023, eqs 6 to 8, literally: no limit on the total friction force; `hertz-liggghts`:
    The model `hertz tangential history` of LIGGGHTS 3.8 (normal_model_hertz.h, tangential_model_history.h);
    `hertz-lammps`: `hertz/material` with `tangential mindlin` of LAMMPS' pair style granular (pair_granular.cpp,
    January 2022); `linear`: Linear springs and dashpots (Pongó et al. 2022)."""
    friction: object
    """Friction coefficient μ between grains, and at walls without their own. Range: of at least 0."""
    rolling_friction: object
    """Rolling friction coefficient μ_r: the torque is at most μ_r R F_n; for R see `rolling_model`. Range: of at
    least 0."""
    restitution: object
    """Coefficient of normal restitution e, in (0, 1]; a law by Hertz may state `normal_damping` instead. Range: in
    (0, 1]."""
    damping: Literal["clamped", "textbook", "printed"] | object
    """law: hertz-mindlin or law: linear: `clamped`: damping that gives e with a normal force that never pulls;
    `textbook`: the papers' formula; `printed`: as `textbook`, but walls use the grain-grain damping, as in Pongó et
    al. (law linear).

    law: hertz-printed or law: hertz-liggghts or law: hertz-lammps: `textbook`: C_n = sqrt(5/6) ln(1/e)/sqrt(pi^2 +
    ln^2 e), which gives e if the normal force may pull; `clamped`: damping that gives e if it may not."""
    rolling: Literal["full", "rolling"] | object
    """`full`: rolling friction resists all relative rotation, also twist (Fan et al. 2023, eq 8, literally);
    `rolling`: only its tangential part."""
    rolling_model: Literal["cdt", "epsd"] | object
    """`cdt`: constant directional torque (Fan et al. 2023, eq 8), with R the radius of the smaller grain; grains
    held by rolling friction alone creep. `epsd`: elastic-plastic spring-dashpot (Ai et al. 2011, model C), with
    effective radius R = r_i r_j/(r_i + r_j), at walls the grain radius; grains that it holds rest. Spheres only."""
    rolling_stiffness: object
    """Stiffness of rolling springs as k_r/(k_n μ_r² R²), k_n = F_n/δ without damping; none: 2.25 (Ai et al. 2011).
    Range: above 0."""
    rolling_damping: object
    """Damping ratio η_r of rolling springs; none: 0.3. Range: of at least 0."""
    shear_modulus: object
    """Shear modulus G of the grains' material; or state `youngs_modulus` [Pa]. Range: above 0."""
    poisson_ratio: object
    """Poisson's ratio ν of the grains' material, in (-1, 1/2]. Range: in (-1, 0.5]."""
    tangential_damping: object
    """law: hertz-mindlin or law: hertz-printed or law: hertz-liggghts or law: hertz-lammps: Ratio C_t/C_n of
    tangential to normal damping (Fan et al. do not give C_t). Range: of at least 0.

    law: linear: Ratio γ_t/γ_n of tangential to normal damping. Range: of at least 0."""
    normal_damping: object
    """Value of C_n, instead of one from the coefficient of restitution; none: as `damping` says. Range: of at least
    0."""
    youngs_modulus: object
    """Young's modulus E of the grains' material, instead of `shear_modulus` = E/(2 (1 + ν)) [Pa]. Range: above 0."""
    tension: object
    """The normal force may pull as grains separate, as in the paper or code of the law."""
    normal_stiffness: object
    """Normal stiffness k_n; or state `contact_time`, or `largest_overlap` with `impact_speed` [N/m]. Range: above
    0."""
    tangential_stiffness: object
    """Ratio k_t/k_n of tangential to normal stiffness. Range: in (0, 10]."""
    contact_time: object
    """Duration t_c of a collision of two of the lightest grains, instead of `normal_stiffness`: k_n = m (π² + ln²
    e)/(2 t_c²) with the mass m of a grain. This is the contact time of a spring and dashpot whose force may pull
    [s]. Range: above 0."""
    largest_overlap: object
    """Largest overlap δ in a collision of two of the heaviest grains without damping, instead of
    `normal_stiffness`: k_n = m v²/(2 δ²) with the mass m of a grain and v the `impact_speed` [m]. Range: above 0."""
    impact_speed: object
    """Relative velocity v of the grains in the collision that `largest_overlap` is for [m/s]. Range: above 0."""
    between: Sequence[ContactBetweenKeys | object] | object


class ContainerPlanesKeys(TypedDict, total=False):
    """Section `container.planes[]`."""

    name: object
    """Name of the plane in results, `flow_rate_NAME`: lower-case letters, digits and hyphens."""
    z: object
    """Height of the plane [m]."""


class ContainerZonesKeys(TypedDict, total=False):
    """Section `container.zones[]`."""

    name: object
    """Name of the zone in results, `velocity_z_NAME`: lower-case letters, digits and hyphens."""
    low: object
    """Lower corner x, y, z of the box [m]."""
    high: object
    """Upper corner [m]."""


class ContainerLipKeys(TypedDict, total=False):
    """Section `container.lip`."""

    radius: object
    """Radius of the rounded edge; 0: it is sharp [m]. Range: of at least 0."""
    thickness: object
    """Height of the edge from the outlet's plane to its lower end, also rounded; none: as little as the radius
    allows, twice the radius of a flat bottom [m]. Range: above 0."""


class ContainerPartsShapeKeys(TypedDict, total=False):
    """Section `container.parts[].shape`."""

    kind: Literal["plane", "strip", "frustum", "mesh", "thick-plate"] | object
    """`plane`: The half-space behind an infinite plane; `normal` points to the grains; `strip`: A thin plate: the
    segment from `start` to `end` in the x-z plane [m], infinite along y; `frustum`: A thin plate round the vertical
    axis x = y = 0: a segment in the plane of radius and height, rotated about it; `mesh`: A surface of triangles
    from a file. Both sides of it are walls, so it may be a thin sheet; `thick-plate`: All points within `radius` of
    a middle line, which goes from `far` to `edge` and then down to `foot`."""
    point: object
    """A point of the plane [m]."""
    normal: object
    """Direction towards the grains, of any length."""
    start: object
    """x and z of one edge [m]."""
    end: object
    """x and z of the other edge [m]."""
    lower: object
    """Radius and z of the inner edge, the rim [m]."""
    upper: object
    """Radius and z of the other edge; its radius is not smaller [m]."""
    smooth: object
    """Largest angle between triangles that stand for one curved surface, on which a grain has one contact; 0 deg:
    none, 15 deg is usual for cylinders and cones [rad]. Range: in [0, 1.0472]."""
    encloses: object
    """Grains are within the closed surface, as in a drum; false: around it, or on both sides of a sheet."""
    file: object
    """File in the format STL, OBJ or PLY, named from the folder of the study, at most 64 MB."""
    unit: Literal["m", "cm", "mm", "um", "inch"] | object
    """Unit of the numbers in the file, which states none."""
    scale: object
    """Factor by which it is enlarged. Range: above 0."""
    rotate: object
    """Angles of rotations about x, then y, then z [rad]."""
    at: object
    """Place of the file's origin [m]."""
    allow: Literal["non-manifold", "t-junctions", "intersections"] | object
    """Flaws to accept: non-manifold, t-junctions or intersections."""
    far: object
    """x, or radius, and z of the end of the middle line that is away from the edge [m]."""
    edge: object
    """x, or radius, and z of the bend at the edge [m]."""
    foot: object
    """x, or radius, and z of the lower end of the edge; that of `edge` if there is no more of it [m]."""
    radius: object
    """Distance of the surface from the middle line, which is the radius of the rounded edge; 0: a sharp edge [m].
    Range: of at least 0."""
    turned: object
    """Rotated about the vertical axis, as the bottom of a cylinder."""


class ContainerPartsMotionKeys(TypedDict, total=False):
    """Section `container.parts[].motion`."""

    velocity: object
    """Velocity of the surface along x, y and z, within the surface; the wall itself stays where it is [m/s]."""
    spin: object
    """Angular velocity of the surface about the vertical axis x = y = 0 [rad/s]."""


class ContainerPartsMovesRotationKeys(TypedDict, total=False):
    """Section `container.parts[].moves.rotation`."""

    axis: object
    """Direction of the axis, of any length; counter-clockwise seen from its tip."""
    origin: object
    """A point of the axis, about which the torque on the part is counted [m]."""
    rate: object
    """Angular velocity [rad/s]."""


class ContainerPartsMovesVibrationKeys(TypedDict, total=False):
    """Section `container.parts[].moves.vibration`."""

    direction: object
    """Direction, of any length."""
    amplitude: object
    """Amplitude A [m]. Range: above 0."""
    frequency: object
    """Frequency f [Hz]. Range: above 0."""
    phase: object
    """Phase φ at the opening [rad]."""


class ContainerPartsMovesKeys(TypedDict, total=False):
    """Section `container.parts[].moves`."""

    velocity: object
    """Constant velocity along x, y and z [m/s]."""
    rotation: ContainerPartsMovesRotationKeys | object
    vibration: ContainerPartsMovesVibrationKeys | object


class ContainerPartsKeys(TypedDict, total=False):
    """Section `container.parts[]`."""

    name: object
    """Name that `walls` and friction springs refer to: lower-case letters, digits and hyphens."""
    opens: object
    """`start`: the wall stands while the container is filled and vanishes when the discharge starts; a time: it
    vanishes so long after that start (parts of kind `mesh`). None: it stays [s]. Range: above 0 or start."""
    shape: ContainerPartsShapeKeys | object
    motion: ContainerPartsMotionKeys | object
    moves: ContainerPartsMovesKeys | object


class ContainerKeys(TypedDict, total=False):
    """Section `container`."""

    kind: Literal["wedge-hopper", "cylinder-silo", "conical-silo", "box", "primitives"] | object
    """`wedge-hopper`: Quasi-2D silo between a front and a back wall (Fan et al. 2023, Fig. 1); `cylinder-silo`:
    Upright cylinder with a round outlet in the middle of its flat bottom, which may rotate (Pongó et al. 2022);
    `conical-silo`: Upright cylinder above a cone, with a round outlet at the cone's tip; `box`: Box, centred in x
    and y, with its bottom at z = 0; `lid` closes its top; `primitives`: Walls listed one by one; without walls:
    free space. Parts that open at the start stand only in the closed one."""
    sink: object
    """Height z of the plane below the outlet at which grains leave the scene, so that it goes on below the outlet;
    `below-parts`: the lowest point of the parts. None: grains leave just below the outlet [m]. Range: or
    below-parts."""
    width: object
    """kind: wedge-hopper: Inner width L between the side walls [m]. Range: above 0.

    kind: box: Inner size along x [m]. Range: above 0."""
    height: object
    """kind: wedge-hopper: Height H of the side walls above the outlet; grains may start above it [m]. Range: above
    0.

    kind: cylinder-silo: Height of the cylinder above the outlet; grains may start above it [m]. Range: above 0.

    kind: conical-silo: Height of the cylinder's upper end above the outlet; grains may start above it [m]. Range:
    above 0.

    kind: box: Inner size along z [m]. Range: above 0."""
    thickness: object
    """Distance Z between the front and the back wall, or between periodic sides [m]. Range: above 0."""
    angle: object
    """kind: wedge-hopper: Angle α of the bottom from the vertical, 1 to 90 deg: 90 deg is flat, 15 deg a steep
    funnel [rad].

    kind: conical-silo: Angle of the cone from the vertical, at least 1 deg and less than 90 deg [rad]."""
    orifice: object
    """kind: wedge-hopper: Width D of the outlet, less than the width of the hopper; with a lip at its narrowest
    [m]. Range: above 0.

    kind: cylinder-silo or kind: conical-silo: Diameter D of the outlet, less than the cylinder's; with a lip at its
    narrowest [m]. Range: above 0."""
    gap: object
    """Gap s from the left side wall to the near edge of the outlet, at most (L - D)/2; none: centred [m]. Range: of
    at least 0."""
    periodic: Literal["y"] | object
    """kind: wedge-hopper: `y`: it repeats along y, without a front and a back wall; its thickness is the period.

    kind: box: `y`: it repeats along y, without a front and a back wall."""
    diameter: object
    """Inner diameter D_c of the cylinder [m]. Range: above 0."""
    rotation: object
    """Rotation frequency f of the bottom after the opening; positive is counter-clockwise seen from above [Hz]."""
    depth: object
    """Inner size along y [m]. Range: above 0."""
    lid: object
    """A plane closes the top."""
    outlet_plane: object
    """Height z at which grains count as discharged; none: there is no outlet [m]."""
    planes: Sequence[ContainerPlanesKeys | object] | object
    zones: Sequence[ContainerZonesKeys | object] | object
    lip: ContainerLipKeys | object
    parts: Sequence[ContainerPartsKeys | object] | object


class WallsKeys(TypedDict, total=False):
    """Section `walls.*`."""

    friction: object
    """Friction coefficient at this wall. Range: of at least 0."""
    rolling_friction: object
    """Rolling friction coefficient μ_r at this wall. Range: of at least 0."""
    restitution: object
    """Coefficient of normal restitution at this wall, in (0, 1]. Range: in (0, 1]."""
    youngs_modulus: object
    """Young's modulus E of this wall's material, instead of `shear_modulus` [Pa]. Range: above 0."""
    shear_modulus: object
    """Shear modulus G of this wall's material (laws by Hertz); none: as in `contact` [Pa]. Range: above 0."""
    poisson_ratio: object
    """Poisson's ratio ν of this wall's material, only with a modulus; none: as in `contact`. Range: in (-1, 0.5]."""
    normal_stiffness: object
    """Normal stiffness k_n at this wall (law linear) [N/m]. Range: above 0."""


class FeedStreamKeys(TypedDict, total=False):
    """Section `feed.stream`."""

    rate: object
    """Mass that enters per time, as long as the region has free places [kg/s]. Range: above 0."""
    low: object
    """Corner of the region with the least x, y and z: grains lie entirely within [m]."""
    high: object
    """Corner of the region with the largest x, y and z [m]."""
    velocity: object
    """Velocity of the grains as they enter [m/s]."""
    every: object
    """Time between two batches, each as large as the rate says; none: grains enter at every beat [s]. Range: above
    0."""
    layers: object
    """Kinds of grains in the order in which they enter, such as `[a, b, a, b]`: grains of a kind are shared equally
    among its layers; none: in random order."""


class FeedKeys(TypedDict, total=False):
    """Section `feed`."""

    kind: Literal["reinject", "rate"] | object
    """`reinject`: grains that left fall onto the bed again, from random free places above it. `rate`: they enter
    again by `stream`, which brings less than its rate while no grain waits or its region is full."""
    stream: FeedStreamKeys | object


class RestartKeys(TypedDict, total=False):
    """Section `restart`."""

    kind: Literal["break"] | object
    """`break`: grains within 1.5 D of the outlet get random velocities, until one leaves: 0.3 `√(g d*)`, and every
    `√(d*/g)` by as much more, up to 3 `√(g d*)`."""
    wait: object
    """Time without a leaving grain after which the flow counts as stopped, if no grain within 2 D of the outlet is
    faster than 0.01 `√(g d*)` [s]. Range: above 0."""


class FillStreamKeys(TypedDict, total=False):
    """Section `fill.stream`."""

    rate: object
    """Mass that enters per time, as long as the region has free places [kg/s]. Range: above 0."""
    low: object
    """Corner of the region with the least x, y and z: grains lie entirely within [m]."""
    high: object
    """Corner of the region with the largest x, y and z [m]."""
    velocity: object
    """Velocity of the grains as they enter [m/s]."""
    every: object
    """Time between two batches, each as large as the rate says; none: grains enter at every beat [s]. Range: above
    0."""
    layers: object
    """Kinds of grains in the order in which they enter, such as `[a, b, a, b]`: grains of a kind are shared equally
    among its layers; none: in random order."""


class FillNumericsKeys(TypedDict, total=False):
    """Section `fill.numerics`."""

    dt: object
    """Time step [s] [s]. Range: above 0."""
    precision: Literal["double", "mixed"] | object
    """`mixed`: positions and their update in double, contact law in single. If left out, chosen where the study
    states `accuracy.flow_rate`."""
    integrator: Literal["leapfrog"] | object
    """Time integrator; the only choice."""
    skin: object
    """Skin of the neighbour lists, in grain diameters. Range: in (0, 1]."""
    steps_per_beat: object
    """Steps per beat. Measurements are taken and runs are stopped at the ends of beats only. Range: of at least 1."""
    stiffness_scale: object
    """Factor on all stiffnesses of the study. Range: above 0."""
    speed_limit: object
    """Abort the run if any grain is faster than this. If a study leaves it out, H is the height of the container,
    or of the column in which grains start, if that is higher [m/s]. Range: above 0."""
    overlap_limit: object
    """Abort the run if any overlap exceeds this fraction of the grain diameter. Range: in (0, 1]."""


class FillMobiliseKeys(TypedDict, total=False):
    """Section `fill.mobilise`."""

    bottom: object
    """Distance by which the bottom sinks relative to the upright walls, whose surfaces move up instead [m]. Range:
    above 0."""
    velocity: object
    """Velocity of that motion, far below √(g d) [m/s]. Range: above 0."""


class FillKeys(TypedDict, total=False):
    """Section `fill`."""

    kind: Literal["rain", "gas", "planar", "dense", "file", "stream"] | object
    """Start of the grains: `rain`, a loose column of slow grains; `gas`, a denser one of fast grains; `planar`, a
    rain in the middle plane between front and back walls; `dense`, a bed pushed together that has little left to
    fall; `file`, at the positions in `fill.file`; `stream`, one after another through the region of `fill.stream`."""
    file: object
    """File of the grains, in the folder of the study (kind: file): a CSV file, a text dump of LAMMPS or LIGGGHTS,
    or a data file of LAMMPS."""
    shift: object
    """Displacement of all grains of the file; none: they stay where they are [m]."""
    until: object
    """Time after the start of the filling at which the outlet opens, whether the bed rests or not; `placed`: at
    once, so that grains fall into an open container. None: when the bed is at rest [s]. Range: above 0 or placed."""
    friction: object
    """Friction coefficient of grains and walls during filling; none: as in the study. Range: of at least 0."""
    contact: ContactKeys | object
    """Contact law during filling, with the keys of `contact`; none: as in the study. So studies of several laws can
    start from the same beds."""
    settled_below: object
    """Kinetic energy per grain, in units of m g d, below which the bed is at rest. If left out: 1e-6, and 1e-3
    after a `dense` start. Range: in (0, 1]."""
    moving: object
    """Fraction of the grains that may still move in a bed at rest: each slow grain has less than `settled_below`.
    None: 1 % for rods and for spheres without rolling friction, which may roll for ever; else 0, and 0 if
    `settled_below` is stated or after a `dense` start. Range: in [0, 1]."""
    surface_motion: object
    """Move surfaces of walls (`container.rotation`, `container.parts[].motion`) during filling too."""
    max_time: object
    """Longest filling; a bed that moves after this time is an error [s]. Range: above 0."""
    stream: FillStreamKeys | object
    numerics: FillNumericsKeys | object
    mobilise: FillMobiliseKeys | object


class NumericsKeys(TypedDict, total=False):
    """Section `numerics`."""

    dt: object
    """Time step [s] [s]. Range: above 0."""
    precision: Literal["double", "mixed"] | object
    """`mixed`: positions and their update in double, contact law in single. If left out, chosen where the study
    states `accuracy.flow_rate`."""
    integrator: Literal["leapfrog"] | object
    """Time integrator; the only choice."""
    skin: object
    """Skin of the neighbour lists, in grain diameters. Range: in (0, 1]."""
    steps_per_beat: object
    """Steps per beat. Measurements are taken and runs are stopped at the ends of beats only. Range: of at least 1."""
    stiffness_scale: object
    """Factor on all stiffnesses of the study. Range: above 0."""
    speed_limit: object
    """Abort the run if any grain is faster than this. If a study leaves it out, H is the height of the container,
    or of the column in which grains start, if that is higher [m/s]. Range: above 0."""
    overlap_limit: object
    """Abort the run if any overlap exceeds this fraction of the grain diameter. Range: in (0, 1]."""


class StudyKeys(TypedDict, total=False):
    """All keys of a study."""

    name: object
    """Name of the study: letters, digits, - and _."""
    about: object
    """Purpose of the study, in a sentence."""
    replicates: object
    """Minimum number of beds per point; their seeds are 1, 2, 3 ... Range: of at least 1."""
    discharges_per_bed: object
    """Number of discharges of each bed: the second and further ones start with small random velocities. `auto`: the
    number that is cheapest for `accuracy.flow_rate`, from how much of the scatter beds and flow have each. Range:
    of at least 1 or auto."""
    accuracy: AccuracyKeys | object
    measure: Sequence[Literal["flow_rate", "outlet_profiles", "packing", "orifice", "contact_stress", "ledger", "outlets", "planes", "composition", "residence", "energy", "clogging", "arch", "wall_stress", "bulk_stress", "velocities", "part_forces"] | object] | object
    """Names of the measurements to take."""
    fit: Sequence[Literal["beverloo", "janda", "beverloo_3d", "janda_3d", "power", "exponential"] | object] | object
    """Names of the laws to fit."""
    window: WindowKeys | object
    stop: StopKeys | object
    record: RecordKeys | object
    adapt: Mapping[str, object] | object
    grains: GrainsKeys | object
    contact: ContactKeys | object
    container: ContainerKeys | object
    walls: Mapping[str, WallsKeys | object] | object
    gravity: object
    """Acceleration of gravity g, along -z [m/s^2]. Range: of at least 0."""
    feed: FeedKeys | object
    restart: RestartKeys | object
    fill: FillKeys | object
    numerics: NumericsKeys | object
    sweep: Swept | object
    points: Sequence[Swept | object] | object
    reference: Mapping[str, object] | object
    calibrate: Mapping[str, object] | object
    include: str | Sequence[str] | object


LawName: TypeAlias = Literal["beverloo", "janda", "beverloo_3d", "janda_3d", "power", "exponential"]
"""Names of the laws of flow."""


KEYS = """\
    name, about, replicates, discharges_per_bed, measure, fit, gravity [m/s^2]
    accuracy: flow_rate, clogging, max_replicates, calibration, numerics, count_suspect
    window: start, end, after [s], until [s], gap [s], moment [s], interval [s], layer [m]
    stop: discharged, max_time [s], stall [s], still, fill_height [m]
    record: every [s], replicates, film
    grains: shape, diameter [m], density [kg/m^3], count, length [m], centres [m], diameters [m]
    grains.sizes: kind, smallest [m], mean [m], deviation [m], median [m], spread, by, diameters [m],
        number_fractions, mass_fractions
    grains.kinds[]: name, share, mass_share, diameter [m], density [kg/m^3], youngs_modulus [Pa], shear_modulus
        [Pa], poisson_ratio
    contact: law, friction, rolling_friction, restitution, damping, rolling, rolling_model, rolling_stiffness,
        rolling_damping, shear_modulus [Pa], poisson_ratio, tangential_damping, normal_damping, youngs_modulus [Pa],
        tension, normal_stiffness [N/m], tangential_stiffness, contact_time [s], largest_overlap [m], impact_speed
        [m/s]
    contact.between[]: friction, rolling_friction, restitution, kinds, normal_stiffness [N/m]
    container: kind, sink [m], width [m], height [m], thickness [m], angle [rad], orifice [m], gap [m], periodic,
        diameter [m], rotation [Hz], depth [m], lid, outlet_plane [m]
    container.planes[]: name, z [m]
    container.zones[]: name, low [m], high [m]
    container.lip: radius [m], thickness [m]
    container.parts[]: name, opens [s]
    container.parts[].shape: kind, point [m], normal, start [m], end [m], lower [m], upper [m], smooth [rad],
        encloses, file, unit, scale, rotate [rad], at [m], allow, far [m], edge [m], foot [m], radius [m], turned
    container.parts[].motion: velocity [m/s], spin [rad/s]
    container.parts[].moves: velocity [m/s]
    container.parts[].moves.rotation: axis, origin [m], rate [rad/s]
    container.parts[].moves.vibration: direction, amplitude [m], frequency [Hz], phase [rad]
    walls.*: friction, rolling_friction, restitution, youngs_modulus [Pa], shear_modulus [Pa], poisson_ratio,
        normal_stiffness [N/m]
    feed: kind
    feed.stream: rate [kg/s], low [m], high [m], velocity [m/s], every [s], layers
    restart: kind, wait [s]
    fill: kind, file, shift [m], until [s], friction, contact, settled_below, moving, surface_motion, max_time [s]
    fill.stream: rate [kg/s], low [m], high [m], velocity [m/s], every [s], layers
    fill.numerics: dt [s], precision, integrator, skin, steps_per_beat, stiffness_scale, speed_limit [m/s],
        overlap_limit
    fill.mobilise: bottom [m], velocity [m/s]
    numerics: dt [s], precision, integrator, skin, steps_per_beat, stiffness_scale, speed_limit [m/s], overlap_limit
"""
"""The keys of a study by sections, with SI units."""
