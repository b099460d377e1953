"""Plans with forecast and warnings about the study. Only runs that do not fit into memory are refused."""

import itertools
import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from labbook.backend import Backend, unready
from labbook.backend.machine import cores, memory
from labbook.filling.bed import PACKED, bed_height
from labbook.fit import LAWS
from labbook.lab.catalogue import Catalogue
from labbook.lab.folder import LabFolder
from labbook.lab.packings import load_packing
from labbook.lab.provenance import provenance
from labbook.lab.records import Unreadable
from labbook.measure import MEASURES
from labbook.measure.clogging import Clogging
from labbook.measure.packing import PackingStructure
from labbook.measure.steady import FEWEST
from labbook.plan.demand import PointDemand
from labbook.plan.devices import parse_devices, slots, speeds
from labbook.plan.forecast import Outline, discharge_work, fill_work, film_bytes, forecast, outline
from labbook.plan.plan import QUANTITY, Item, Plan, Planner
from labbook.plan.possible import check, leak_of
from labbook.scene import ContactLaw, CylinderSilo, Scene
from labbook.scene.contact import Softer
from labbook.scene.quantities import format_distinct, percent, size, span
from labbook.study import Point, Study
from labbook.study.applicable import undamped
from labbook.study.pilot import first_needed
from labbook.study.problems import and_others
from labbook.study.schema import AUTO
from labbook.study.window import HIGH, high_until

NARROW = {"sphere": 5.0, "spherocylinder": 3.0, "clump": 3.0}
"""Outlet width, in largest dimensions of a grain, below which outlets often clog, by shape."""
RING = 4.0
"""Width, in grain diameters, of the flat bottom around the hole of a cylinder below which W depends on single rows of
grains (benchmarks/narrow_ring.py)."""
SOFT = 3e-3
"""Overlap at the foot of the bed, in diameters, up to which grains count as hard: softer ones flow differently."""
_MIN_STEP_FACTOR, _LONG_PLAN = 3.0, 600.0
"""Factor by which steps are smaller than needed, and time of the plan [s], from which a hint is given."""
_LARGE_RECORDING = 2e9
"""Size of a recording from which a warning is given [bytes]."""
_MAX_NAMED = 3


class TooLarge(Exception):
    """The runs do not fit into the memory of this machine; the message has file, key and remedy."""


def foresee(study: Study, catalogue: Catalogue, backend: Backend, device: str) -> Plan:
    """Plan what a study lacks in a lab, with forecast, warnings, and the plan of its pilot if one runs first.

    A backend whose packages are not installed can plan, with a warning.

    Args:
        study: The study.
        catalogue: Index of the lab.
        backend: Backend of the runs.
        device: Device, or several: `cuda:0,cuda:1`.

    Raises:
        Unsupported: The backend or a device cannot make the runs.
        Conflict: Observations or containers are impossible.
        MeasureError: A measure does not fit a scene.
        TooLarge: The runs do not fit into memory.
    """
    plan = _make_plan(study, catalogue, backend, device, measured=True)
    if device == "cpu" and (refusal := too_large(plan, cores(), memory())):
        raise TooLarge(refusal)
    needed = first_needed(study)
    return replace(plan, pilot=None if needed is None else foresee(needed, catalogue, backend, device))


def forewarn(study: Study, catalogue: Catalogue, backend: Backend, device: str) -> tuple[str, ...]:
    """Return the warnings of `foresee`, also for runs that do not fit into memory; none if nothing is left to run.

    The speed of this machine is not measured. Raises what `foresee` does, except TooLarge.
    """
    plan = _make_plan(study, catalogue, backend, device, measured=False)
    return plan.warnings if plan.todo else ()


def _make_plan(study: Study, catalogue: Catalogue, backend: Backend, device: str, measured: bool) -> Plan:
    """Return the plan with its forecast and warnings, without a pilot."""
    planner = Planner(study, catalogue, backend.capabilities)
    device, *other_devices = parse_devices(device, backend)
    for other_device in other_devices:
        check(backend, other_device, planner.points[:1])
    check(backend, device, planner.points)
    plan = planner.plan()
    workers = cores() if device == "cpu" else 1
    machine = provenance(device)["machine"]
    members = slots(backend, device, plan.points)
    prediction = forecast(plan, catalogue, machine, device, workers, backend, members, measured)
    if other_devices:
        # Devices share the work in proportion to their speeds, and each of them compiles.
        first, *other_speeds = speeds((device, *other_devices), backend, [point.shared for point in plan.points])
        compiling = prediction.compiling
        seconds = (prediction.seconds - compiling) * first / (first + sum(other_speeds)) + compiling
        workers = prediction.workers + sum(cores() if other == "cpu" else 1 for other in other_devices)
        prediction = replace(prediction, seconds=seconds, workers=workers)
    reason = unready(backend) if plan.todo else ""
    unready_warning = (f"{reason}; until then labbook run refuses",) if reason else ()
    warnings = (*unready_warning, *cut_short(plan, catalogue.lab), *advice(plan, prediction.seconds))
    return replace(
        plan, forecast=prediction, warnings=warnings, shares=_shares(plan, planner), stops=_stops(plan, planner)
    )


def _shares(plan: Plan, planner: Planner) -> dict[str, tuple[str, ...]]:
    """Labels of points, by the cheapest number of discharges of their beds with its reason; empty if the study states
    it."""
    lines: dict[str, tuple[str, ...]] = {}
    for point in plan.points if plan.study.discharges_per_bed == AUTO else ():
        line = planner.shares_in_words(point, fill_work(point.items[0].demand) / discharge_work(point.shared))
        lines[line] = (*lines.get(line, ()), point.shared.point.label)
    return lines


def _stops(plan: Plan, planner: Planner) -> dict[str, tuple[str, ...]]:
    """Labels of points, by stops so far and replicates expected; empty if no error of q is requested."""
    lines: dict[str, tuple[str, ...]] = {}
    for point in plan.points if plan.study.accuracy.clogging is not None else ():
        line = planner.stops_in_words(point)
        lines[line] = (*lines.get(line, ()), point.shared.point.label)
    return lines


def advice(plan: Plan, seconds: float = math.inf) -> Iterator[str]:
    """Yield warnings about a plan that is forecast to take `seconds`: file, key, reason and remedy."""
    file = plan.study.path
    points = [(point.shared, outline(point.shared)) for point in plan.points]
    yield from _identical_points(plan)
    yield from limits(plan.study)
    yield from _possible_leaks(plan)
    if Clogging.name not in plan.study.measure:
        yield from _narrow(file, points)
    yield from _too_few_grains(plan)
    yield from _too_few_outlets(plan)
    yield from _empty_measures(plan.study, points)
    yield from _without_end(plan)
    yield from _large_recordings(plan)
    yield from _undamped(plan)
    is_single = plan.rule.cap < 2 and not (plan.study.fed and plan.study.accuracy.flow_rate is not None)
    if is_single:
        remedy = "use replicates: 3 or more, or accuracy.flow_rate"
        reason = "with one run per point no number has an error from replicates"
        if plan.study.discharges_per_bed != 1:
            reason = "with one bed per point no number has an error from replicates"
        yield _warning(file, "replicates", reason, remedy)
    if seconds > _LONG_PLAN:
        yield from _stiff(plan.study, points)


def limits(study: Study) -> tuple[str, ...]:
    """Return the warnings that limit the meaning of a study's numbers, for any number of runs. Results repeat them."""
    shared = [PointDemand(study, point) for point in study.points]
    points = [(demand, outline(demand)) for demand in shared]
    warnings = (
        _filling_walls(study),
        _overfull(study.path, points),
        _narrow_rings(study),
        _low_beds(study),
        _soft(study, points),
    )
    return tuple(itertools.chain(*warnings))


def too_large(plan: Plan, workers: int, available: float) -> str | None:
    """Explain why `workers` runs at once exceed the `available` memory [bytes]; None if they fit."""
    if not plan.todo:
        return None
    largest = max((point.shared for point in plan.points), key=lambda shared: outline(shared).memory)
    runs = max(1, min(workers, len(plan.todo)))
    needed = outline(largest).memory * runs
    if needed <= available:
        return None
    count, several = largest.scene.grains.count, f"{runs} runs at once of " if runs > 1 else ""
    takes, has = format_distinct(needed / 1e9, available / 1e9, of_limit=3)
    reason = f"{several}{count} grains take about {takes} GB of memory, and this machine has {has} GB"
    fits = available / needed * count
    step = 10 ** math.floor(math.log10(fits))
    remedy = f"use at most {fits // step * step:.0f} grains, or a larger machine"
    return _warning(plan.study.path, "grains.count", reason, remedy)


def cut_short(plan: Plan, lab: LabFolder) -> Iterator[str]:
    """Yield warnings about beds that fall to stop.fill_height before the window ends.

    Heights are those of existing packings, else forecast.
    """
    end = plan.study.window.end
    if plan.study.window.timed:
        return
    heights: dict[str, float | None] = {}
    lowest: dict[PointDemand, tuple[float, float | None]] = {}
    for item in plan.items:
        shared = item.demand.shared
        if shared.stop.fill_height is None:
            continue
        if item.keys.packing not in heights:
            heights[item.keys.packing] = _height(item, lab)
        height = heights[item.keys.packing]
        reached = shared.reach(height)
        if reached < min(end, lowest.get(shared, (math.inf, None))[0]):
            lowest[shared] = reached, height
    if lowest:
        yield _too_low(plan.study.path, end, lowest)


def _height(item: Item, lab: LabFolder) -> float | None:
    """Height [m] of the bed of a run; None if its packing is missing."""
    if not item.packed:
        return None
    scene = item.demand.point.scene
    try:
        packing = load_packing(lab.packing(item.keys.packing))
    except Unreadable:
        return None
    return bed_height(scene.grains, packing, scene.container.outlet_plane or 0.0)


def _too_low(file: Path, end: float, lowest: dict[PointDemand, tuple[float, float | None]]) -> str:
    """Text of the warning that the bed falls to `stop.fill_height` before the window ends."""
    shared, (reached, height) = min(lowest.items(), key=lambda entry: entry[1][0])
    stop, height_now = shared.stop.fill_height, height or shared.expected_height
    assert stop is not None
    assert height_now is not None
    start = shared.study.window.start
    earlier = f" a window.end below {reached:.2f}," if reached > start + 0.01 else ""
    tense = "is" if height else f"will be, at a packing fraction of {PACKED},"
    fallen, _ = format_distinct(100 * reached, 100 * end, digits=2)
    reason = (
        f"the bed {tense} {height_now * 1e3:.3g} mm high and has fallen to {stop * 1e3:.4g} mm "
        f"with {fallen} % discharged, before the window ends (window.end, {end:g}), at {_label_list(lowest)}"
    )
    remedy = f"use a stop.fill_height below {(1 - end) * height_now * 1e3:.3g} mm,{earlier} or more grains"
    return _warning(file, "stop.fill_height", reason, remedy)


def _narrow(file: Path, points: Sequence[tuple[PointDemand, Outline]]) -> Iterator[str]:
    def is_narrow(shared: PointDemand, shape: Outline) -> bool:
        return shape.ratio is not None and shape.ratio < NARROW[shared.scene.grains.shape] * (1 - 1e-9)

    narrow_points = [(shared, shape) for shared, shape in points if is_narrow(shared, shape)]
    if narrow_points:
        shared, shape = min(narrow_points, key=lambda pair: pair[1].ratio or 0)
        rods, noun = not shared.scene.grains.round, shared.scene.grains.noun
        unit = f"lengths of a {noun}" if rods else "diameters of a grain"
        least = NARROW[shared.scene.grains.shape]
        ratio, bound = format_distinct(shape.ratio or 0.0, least, digits=2)
        unit = f"length of a {noun}" if rods and ratio == "1" else "diameter of a grain" if ratio == "1" else unit
        reason = f"the outlet is {ratio} {unit} wide ({shape.extent * 1e3:.3g} mm), and below {bound} it often clogs"
        smallest_opening = math.ceil(least * shape.extent * 1e4 * (1 - 1e-9)) / 10  # mm
        yield _warning(file, "container.orifice", reason, f"use {smallest_opening:g} mm or more", narrow_points, points)


def _overfull(file: Path, points: Sequence[tuple[PointDemand, Outline]]) -> Iterator[str]:
    overfull = [
        (shared, shape)
        for shared, shape in points
        if shape.height is not None and shape.height > getattr(shared.scene.container, "height", math.inf)
    ]
    if overfull:
        shared, shape = max(overfull, key=lambda pair: pair[1].height or 0)
        height, top = shape.height or 0.0, float(getattr(shared.scene.container, "height", math.inf))
        high, walls = format_distinct(height * 1e3, top * 1e3)
        height_text = f"the grains will stand about {high} mm high, at a packing fraction of {PACKED}"
        reason = f"{height_text}, above the walls ({walls} mm)"
        remedy = f"make the container {float(f'{1.1e3 * height:.3g}'):g} mm high or more, or lower grains.count"
        yield _warning(file, "container.height", reason, remedy, overfull, points)


def _identical_points(plan: Plan) -> Iterator[str]:
    """Warn of points with identical runs: the key that differs between them has no effect."""
    by_run: dict[str, list[Point]] = {}
    for point_plan in plan.points:
        if point_plan.items:
            by_run.setdefault(point_plan.items[0].keys.run, []).append(point_plan.shared.point)
    by_key: dict[str, list[Point]] = {}
    for points in by_run.values():
        for key in points[0].at:
            if len({point.at.get(key) for point in points}) > 1:
                by_key.setdefault(key, points)
    for key, points in by_key.items():
        labels = "; ".join(point.label for point in points[:3]) + (" ..." if len(points) > 3 else "")
        reason = f"it changes nothing here: these points are the same runs, and would count as several ({labels})"
        yield _warning(plan.study.path, key, reason, "leave it out, or vary a key that the runs depend on")


def _filling_walls(study: Study) -> Iterator[str]:
    """Warn of properties of walls that exist only during the filling, and so have no effect on the flow."""
    flow_walls: dict[str, list[str]] = {}
    for scene in (point.scene for point in study.points):
        wall_names = [wall.name for wall in scene.container.walls()]
        for name in scene.walls:
            if name != "all" and name not in wall_names:
                flow_walls[name] = [wall for wall in wall_names if wall.startswith(name)] or wall_names
    for name, wall_names in flow_walls.items():
        reason = "this wall stands only while the bed is filled: the flow does not feel it"
        yield _warning(study.path, f"walls.{name}", reason, f"for the flow use {', '.join(wall_names)}")


def _possible_leaks(plan: Plan) -> Iterator[str]:
    """Warn of containers that may lose grains during the filling, which only the filling will show."""
    for point in plan.points:
        hole = leak_of(point.shared)
        if hole is not None:
            d = point.shared.scene.grains.finest
            reason = (
                "whether grains reach it while the container is filled cannot be told: gaps about as wide as a grain "
                f"({d * 1e3:.3g} mm) were looked for on a grid of {hole.spacing * 1e3:.2g} mm, and one may be at "
                f"{hole.position_text}"
            )
            remedy = "make gaps clearly narrower or wider than the smallest grain; a filling that loses grains fails"
            yield _warning(plan.study.path, "container.outlet_plane", reason, remedy)
            return


def _narrow_rings(study: Study) -> Iterator[str]:
    """Warn of cylinders with so little bottom around the outlet that W does not depend on the outlet alone."""
    silos = [(point, point.scene.container) for point in study.points if point.scene.grains.shape == "sphere"]
    rings = [
        ((silo.diameter - silo.orifice) / 2 / point.scene.grains.diameter, point, silo)
        for point, silo in silos
        if isinstance(silo, CylinderSilo)
    ]
    narrow_rings = [ring for ring in rings if ring[0] < RING * (1 - 1e-9)]
    if narrow_rings and "flow_rate" in study.measure:
        width, point, silo = min(narrow_rings, key=lambda ring: ring[0])
        rows, bound = format_distinct(width, RING, digits=3)
        reason = (
            f"the bottom around the outlet of {1e3 * silo.orifice:g} mm is {rows} diameters of a grain wide: below "
            f"{bound} W depends on rows of grains at the wall, scatters, and is not smooth in the outlet"
        )
        wide = silo.orifice + 2 * RING * point.scene.grains.diameter
        remedy = f"use {math.ceil(1e3 * wide * (1 - 1e-9)):g} mm or more, or narrower outlets"
        yield _warning(study.path, "container.diameter", reason, remedy)


def _low_beds(study: Study) -> Iterator[str]:
    """Warn of beds that are too low for a steady flow at the end of a window that labbook chose."""
    if (
        study.fed
        or study.window.timed
        or "end" in study.definition.get("window", {})
        or "flow_rate" not in study.measure
    ):
        return
    low_points = [(point, until) for point in study.points
           if (until := high_until(point.scene)) is not None and until < study.window.end - 1e-9]  # fmt: skip
    if low_points:
        point, until = min(low_points, key=lambda entry: entry[1])
        count = point.scene.grains.count
        needed = count * (1 - until) / (1 - study.window.end)
        step = 10 ** max(0, math.floor(math.log10(needed)) - 1)
        reason = (
            f"the bed is less than {HIGH:g} widths high before the window ends, at {percent(study.window.end)} "
            "discharged: W may fall with it"
        )
        remedy = f"use {math.ceil(needed / step) * step:.0f} grains or more, or state window.end"
        yield _warning(study.path, "grains.count", reason, remedy)


def _empty_measures(study: Study, points: Sequence[tuple[PointDemand, Outline]]) -> Iterator[str]:
    """Warn of measures that will probably give no number."""
    for name in study.measure:
        affected = [
            (pair, reason_and_remedy)
            for pair in points
            if (reason_and_remedy := MEASURES[name].foreseen_empty(pair[0].scene))
        ]
        if not affected:
            continue
        (_, (reason, remedy)), points_affected = affected[0], [pair for pair, _ in affected]
        laws = [law for law in study.fit if law in LAWS and LAWS[law].of_bulk]
        if name == PackingStructure.name and laws and len(points_affected) == len(points):
            lost = (f"{symbol} of {law}" for law in laws for symbol in LAWS[law].of_bulk)
            reason += f"; without a packing fraction there is no {', no '.join(lost)}"
        yield _warning(
            study.path, "measure", f"{name} will probably be empty: {reason}", remedy, points_affected, points
        )


def _without_end(plan: Plan) -> Iterator[str]:
    """Warn of runs without an outlet that last for the default stop.max_time."""
    closed = all(point.scene.container.outlet_plane is None for point in plan.study.points)
    if not closed or plan.study.stop.max_time is not None:
        return
    longest = max(point.shared.stop.max_time for point in plan.points)
    reason = f"this container has no outlet, so every run lasts {longest:.3g} s"
    remedy = "state stop.max_time; for measurements of the packing alone, 10 ms are enough"
    yield _warning(plan.study.path, "stop.max_time", reason, remedy)


def _undamped(plan: Plan) -> Iterator[str]:
    """Warn of fillings that lose energy by friction alone.

    300 spheres with a friction of 0.5 still hovered at 1e-4 m g d after 7 s; those with a restitution of 0.2 rest
    within 1 s.
    """
    for point in plan.study.points:
        if (at_fault := undamped(point)) is not None:
            key, remedy = at_fault
            reason = "impacts lose no energy while the bed is filled: by friction alone it rests late, or never"
            yield _warning(plan.study.path, key, reason, remedy)
            return


def _too_few_grains(plan: Plan) -> Iterator[str]:
    """Warn of windows in which too few grains leave for a flow rate."""
    study = plan.study
    window, stop = study.window, study.stop
    if QUANTITY not in study.measure or window.timed or study.fed:
        return
    fraction = min(window.end, stop.discharged) - window.start
    few = min(point.scene.grains.count for point in study.points)
    if few * fraction <= FEWEST:
        reason = (
            f"of {few} grains {max(0, int(few * fraction))} leave between {percent(window.start)} and "
            f"{percent(window.start + fraction)}, and a flow rate needs more than {FEWEST}"
        )
        larger = f"use {math.ceil(1.1 * FEWEST / fraction / 50) * 50} grains or more, or " if fraction > 0 else ""
        yield _warning(study.path, "grains.count", reason, f"{larger}widen window")


def _too_few_outlets(plan: Plan) -> Iterator[str]:
    """Warn of fits with fewer outlets than parameters."""
    outlets: dict[tuple, set[float]] = defaultdict(set)
    for point in plan.study.points:
        other_keys = tuple((key, value) for key, value in point.at.items() if key != "container.orifice")
        several = point.scene.container.outlets if len(point.scene.container.outlets) > 1 else ()
        widths = [outlet.width for outlet in several]
        outlets[other_keys].update(widths or [float(getattr(point.scene.container, "orifice", math.nan))])
    fewest = min(map(len, outlets.values()))
    underdetermined = [name for name in plan.study.fit if name in LAWS and len(LAWS[name].free) >= fewest]
    if underdetermined:
        needed = max(len(LAWS[name].free) for name in underdetermined) + 1
        parameters = ", ".join(f"{name} has {len(LAWS[name].free)} parameters" for name in underdetermined)
        reason = f"{fewest} {'orifice is' if fewest == 1 else 'orifices are'} too few: {parameters}"
        several = any(len(point.scene.container.outlets) > 1 for point in plan.study.points)
        remedy = f"give {needed} or more lids unlike widths" if several else ""
        remedy = remedy or f"sweep {needed} or more values of container.orifice"
        yield _warning(plan.study.path, "fit", reason, remedy)


def _large_recordings(plan: Plan) -> Iterator[str]:
    """Warn of recordings that fill disk and memory."""
    largest = max((point.shared for point in plan.points), key=film_bytes)
    if (bytes_taken := film_bytes(largest)) > _LARGE_RECORDING and (every := largest.frame_interval) is not None:
        interval = span(float(f"{every * bytes_taken / _LARGE_RECORDING:.1g}"))
        reason = (
            f"a recorded run takes about {size(bytes_taken)} on disk, and is read as a whole for pictures and fields"
        )
        yield _warning(
            plan.study.path, "record.every", reason, f"with {interval} it takes about {size(_LARGE_RECORDING)}"
        )


def _stiff(study: Study, points: Sequence[tuple[PointDemand, Outline]]) -> Iterator[str]:
    """Hint at grains much stiffer than their bed needs, which cost steps."""
    hints = []
    by_youngs = "youngs_modulus" in study.definition.get("contact", {})
    for shared, shape in points:
        scale = shared.numerics.stiffness_scale
        youngs = by_youngs or "contact.youngs_modulus" in shared.point.at
        hint = softer(shared.scene.stiffened(scale), shape.height, youngs) if shape.height else None
        if hint:
            key, soft, unit, times = hint
            hints.append((key, soft / scale, unit, times))  # the study states stiffness before it is scaled
    if hints:
        key, soft, unit, times = max(hints, key=lambda shape: shape[-1])
        reason = f"grains this stiff take {times:.2g} times as many steps as the weight of the bed requires"
        remedy = f"with {_rounded(soft)} {unit} grains overlap by at most about {percent(SOFT)} of d"
        yield _warning(study.path, key, reason, remedy)


def _soft(study: Study, points: Sequence[tuple[PointDemand, Outline]]) -> Iterator[str]:
    """Warn of grains so soft that the weight of the bed alone overlaps them by more than the guard allows."""
    by_youngs = "youngs_modulus" in study.definition.get("contact", {})
    for shared, shape in points:
        numerics = shared.filling_numerics
        scene = shared.scene.stiffened(numerics.stiffness_scale)
        grains = scene.grains
        youngs = by_youngs or "contact.youngs_modulus" in shared.point.at
        for where, by_e, law in _stiffnesses(scene, youngs) if shape.height else ():
            pressure = _pressure(scene, shape.height or 0.0)
            overlap, hard = law.overlap(pressure, grains.diameter), law.softer(pressure, SOFT, grains.diameter)
            if overlap is None or hard is None or overlap <= numerics.overlap_limit:
                continue
            key, stiffness_text = _stated_stiffness(hard, by_e)
            reason = (
                f"under the weight of the bed grains this soft overlap by about {overlap:.2g} d, and runs end at "
                f"{numerics.overlap_limit:g} d (numerics.overlap_limit)"
            )
            remedy = (
                f"with {_rounded(stiffness_text / numerics.stiffness_scale)} {hard.unit} it is {percent(SOFT)} of d"
            )
            yield _warning(study.path, f"{where}.{key}", reason, remedy)
            return


def softer(scene: Scene, height: float, youngs: bool = False) -> tuple[str, float, str, float] | None:
    """Find a stiffness at which grains overlap by SOFT d below the bed.

    Where stiffnesses differ, it is that of the stiffest. The time step goes as 1/sqrt(stiffness).

    Args:
        scene: Scene of the discharge.
        height: Height of the bed [m].
        youngs: The study states E in `contact`; the scene has G.

    Returns:
        Key, value, unit, and factor by which steps become fewer; None if that is small.
    """
    pressure, d = _pressure(scene, height), scene.grains.diameter
    laws = [(where, by_e, law.softer(pressure, SOFT, d)) for where, by_e, law in _stiffnesses(scene, youngs)]
    candidates = [
        (where, by_e, softer_law)
        for where, by_e, softer_law in laws
        if softer_law is not None and softer_law.required > 0
    ]
    if not candidates:
        return None
    where, by_e, softer_law = max(candidates, key=lambda entry: entry[2].value / entry[2].required)
    key, stiffness_text = _stated_stiffness(softer_law, by_e)
    times = math.sqrt(softer_law.value / softer_law.required)
    return (f"{where}.{key}", stiffness_text, softer_law.unit, times) if times > _MIN_STEP_FACTOR else None


def _pressure(scene: Scene, height: float) -> float:
    """Pressure p = phi rho g H [Pa] at the foot of a bed of height H [m], which presses grains with the force p d^2."""
    return PACKED * scene.grains.mean_density * scene.gravity * height


def _stated_stiffness(stiffness: Softer, by_e: bool) -> tuple[str, float]:
    """Key in which a study states a stiffness, and the sufficient value. `by_e`: it states Young's modulus."""
    key, ratio = stiffness.alternative if by_e and stiffness.alternative else (stiffness.key, 1.0)
    return key, stiffness.required * ratio


def _stiffnesses(scene: Scene, youngs: bool) -> Iterator[tuple[str, bool, ContactLaw]]:
    """Yield sections that state a stiffness, whether by Young's modulus, and the law of their contacts.

    Walls of another material are left out: contacts with them are at most twice as stiff as those of grains.
    """
    kinds = range(len(scene.grains.species))
    own = "contact.between[]" if scene.contact.material is None else "grains.kinds[]"
    for kind in kinds:
        by_e = bool(scene.grains.kinds) and scene.grains.kinds[kind].youngs_modulus is not None
        for other_kind in kinds[: kind + 1] if scene.contact.material is None else (kind,):
            law = scene.law_between(kind, other_kind)
            yield ("contact", youngs, law) if law == scene.contact else (own, by_e, law)
        for wall in scene.container.walls() if scene.contact.material is None else ():
            if (law := scene.law(wall, kind)) != scene.law_between(kind, kind):
                surface = scene.walls.get(wall.name)
                section = wall.name if surface is not None and surface.normal_stiffness is not None else "all"
                yield f"walls.{section}", False, law


def _rounded(value: float) -> str:
    return f"{float(f'{value:.1g}'):g}"


def _warning(
    file: Path,
    key: str,
    reason: str,
    remedy: str,
    at: Sequence[tuple[PointDemand, Outline]] = (),
    points: Iterable[object] = (),
) -> str:
    """Text of a warning: file, key, reason, points (if only some of `points` have it), remedy."""
    points_text = f" (at {_label_list(shared for shared, _ in at)})" if 0 < len(at) < len(list(points)) else ""
    return f"{file}: {key}: {reason}{points_text}\n    remedy: {remedy}"


def _label_list(points: Iterable[PointDemand]) -> str:
    labels = [shared.point.label for shared in points]
    return f"{'; '.join(labels[:_MAX_NAMED])}{and_others(len(labels) - _MAX_NAMED)}"
