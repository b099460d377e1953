"""A plan with what it will cost, and what the study may well want otherwise: warnings with key and remedy. Refused is
only what does not fit into memory."""

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
from labbook.plan.devices import named, slots, speeds
from labbook.plan.forecast import Outline, discharge_work, fill_work, film_bytes, forecast, outline
from labbook.plan.plan import QUANTITY, Item, Plan, Planner
from labbook.plan.possible import check, leak_of
from labbook.scene import ContactLaw, CylinderSilo, Scene
from labbook.scene.contact import Softer
from labbook.scene.quantities import percent, size, span, told_apart
from labbook.study import Point, Study
from labbook.study.applicable import undamped
from labbook.study.pilot import first_needed
from labbook.study.problems import and_others
from labbook.study.schema import AUTO
from labbook.study.window import HIGH, high_until

NARROW = {"sphere": 5.0, "spherocylinder": 3.0}
"""Outlets below so many largest dimensions of a grain often clog."""
RING = 4.0
"""Width, in grain diameters, of the flat bottom around the hole of a cylinder below which W depends on single rows of
grains (benchmarks/narrow_ring.py)."""
SOFT = 3e-3
"""Overlap at the foot of the bed, in diameters, with which grains are still hard: what is softer flows otherwise."""
_SLOWER, _LONG = 3.0, 600.0
"""Steps as many times smaller than need be, of a plan as long [s], are worth a hint."""
_HEAVY = 2e9
"""Bytes of a recording from which on it is worth a warning."""
_NAMED = 3


class TooLarge(Exception):
    """The runs do not fit into the memory of this machine; the message has file, key and remedy."""


def foresee(study: Study, catalogue: Catalogue, backend: Backend, device: str) -> Plan:
    """What `study` still needs in a lab, with time and disk on `device` (or several: `cuda:0,cuda:1`), warnings, and
    the same of the pilot that runs first, if there is one.

    A backend whose packages are not installed can plan, with a warning. Raises Unsupported, Conflict or MeasureError
    for what cannot be done, TooLarge.
    """
    plan = _foreseen(study, catalogue, backend, device, measured=True)
    if device == "cpu" and (told := too_large(plan, cores(), memory())):
        raise TooLarge(told)
    needed = first_needed(study)
    return replace(plan, pilot=None if needed is None else foresee(needed, catalogue, backend, device))


def forewarn(study: Study, catalogue: Catalogue, backend: Backend, device: str) -> tuple[str, ...]:
    """The warnings of `foresee`, also of runs that do not fit into memory; none where nothing is left to run. The speed
    of this machine is not measured for them. Raises what `foresee` does, except TooLarge."""
    plan = _foreseen(study, catalogue, backend, device, measured=False)
    return plan.warnings if plan.todo else ()


def _foreseen(study: Study, catalogue: Catalogue, backend: Backend, device: str, measured: bool) -> Plan:
    planner = Planner(study, catalogue, backend.capabilities)
    device, *others = named(device, backend)
    for one in others:
        check(backend, one, planner.points[:1])
    check(backend, device, planner.points)
    plan = planner.plan()
    lanes = cores() if device == "cpu" else 1
    machine = provenance(device)["machine"]
    members = slots(backend, device, plan.points)
    ahead = forecast(plan, catalogue, machine, device, lanes, backend, members, measured)
    if others:
        first, *more = speeds((device, *others), backend, [point.shared for point in plan.points])
        shared = (ahead.seconds - ahead.compiling) * first / (first + sum(more)) + ahead.compiling
        ahead = replace(ahead, seconds=shared, lanes=ahead.lanes + sum(cores() if o == "cpu" else 1 for o in others))
    reason = unready(backend) if plan.todo else ""
    unable = (f"{reason}; until then labbook run refuses",) if reason else ()
    warnings = (*unable, *cut_short(plan, catalogue.lab), *advice(plan, ahead.seconds))
    return replace(plan, forecast=ahead, warnings=warnings, shares=_shares(plan, planner), stops=_stops(plan, planner))


def _shares(plan: Plan, planner: Planner) -> dict[str, tuple[str, ...]]:
    """Labels of points by the cheapest number of discharges of their beds and why; none where the study states it."""
    lines: dict[str, tuple[str, ...]] = {}
    for point in plan.points if plan.study.discharges_per_bed == AUTO else ():
        line = planner.shares_in_words(point, fill_work(point.items[0].demand) / discharge_work(point.shared))
        lines[line] = (*lines.get(line, ()), point.shared.point.label)
    return lines


def _stops(plan: Plan, planner: Planner) -> dict[str, tuple[str, ...]]:
    """Labels of points by their stops so far and the replicates expected; none where no error of q is requested."""
    lines: dict[str, tuple[str, ...]] = {}
    for point in plan.points if plan.study.accuracy.clogging is not None else ():
        line = planner.stops_in_words(point)
        lines[line] = (*lines.get(line, ()), point.shared.point.label)
    return lines


def advice(plan: Plan, seconds: float = math.inf) -> Iterator[str]:
    """Warnings about `plan`, which is forecast to take `seconds`: file, key, what, and the remedy."""
    file = plan.study.path
    points = [(point.shared, outline(point.shared)) for point in plan.points]
    yield from _alike(plan)
    yield from limits(plan.study)
    yield from _leaky(plan)
    if Clogging.name not in plan.study.measure:
        yield from _narrow(file, points)
    yield from _too_few_grains(plan)
    yield from _too_few_outlets(plan)
    yield from _empty(plan.study, points)
    yield from _endless(plan)
    yield from _heavy(plan)
    yield from _undamped(plan)
    alone = plan.rule.cap < 2 and not (plan.study.fed and plan.study.accuracy.flow_rate is not None)
    if alone:
        remedy = "use replicates: 3 or more, or accuracy.flow_rate"
        why = "with one run per point no number has an error from replicates"
        if plan.study.discharges_per_bed != 1:
            why = "with one bed per point no number has an error from replicates"
        yield _told(file, "replicates", why, remedy)
    if seconds > _LONG:
        yield from _stiff(plan.study, points)


def limits(study: Study) -> tuple[str, ...]:
    """The warnings that limit what the numbers of a study mean, however many runs it has: file, key, what, remedy.
    Results repeat them."""
    shared = [PointDemand(study, point) for point in study.points]
    points = [(one, outline(one)) for one in shared]
    found = _of_fillings(study), _overfull(study.path, points), _ringed(study), _low(study), _soft(study, points)
    return tuple(itertools.chain(*found))


def too_large(plan: Plan, lanes: int, available: float) -> str | None:
    """Why `lanes` runs at once do not fit into the `available` memory [bytes]; None if they do."""
    if not plan.todo:
        return None
    largest = max((point.shared for point in plan.points), key=lambda shared: outline(shared).memory)
    runs = max(1, min(lanes, len(plan.todo)))
    needed = outline(largest).memory * runs
    if needed <= available:
        return None
    count, several = largest.scene.grains.count, f"{runs} runs at once of " if runs > 1 else ""
    takes, has = told_apart(needed / 1e9, available / 1e9, of_limit=3)
    reason = f"{several}{count} grains take about {takes} GB of memory, and this machine has {has} GB"
    fits = available / needed * count
    step = 10 ** math.floor(math.log10(fits))
    remedy = f"use at most {fits // step * step:.0f} grains, or a larger machine"
    return _told(plan.study.path, "grains.count", reason, remedy)


def cut_short(plan: Plan, lab: LabFolder) -> Iterator[str]:
    """Problems, with file, key and remedy: beds that fall to stop.fill_height before the window ends. Heights are
    those of packings that are there, and foreseen of others."""
    end = plan.study.window.end
    if plan.study.window.timed:
        return
    known: dict[str, float | None] = {}
    lowest: dict[PointDemand, tuple[float, float | None]] = {}
    for item in plan.items:
        shared = item.demand.shared
        if shared.stop.fill_height is None:
            continue
        if item.keys.packing not in known:
            known[item.keys.packing] = _height(item, lab)
        height = known[item.keys.packing]
        there = shared.reach(height)
        if there < min(end, lowest.get(shared, (math.inf, None))[0]):
            lowest[shared] = there, height
    if lowest:
        yield _too_low(plan.study.path, end, lowest)


def _height(item: Item, lab: LabFolder) -> float | None:
    """Height [m] of the bed of a run, None if its packing is not there."""
    if not item.packed:
        return None
    scene = item.demand.point.scene
    try:
        packing = load_packing(lab.packing(item.keys.packing))
    except Unreadable:
        return None
    return bed_height(scene.grains, packing, scene.container.outlet_plane or 0.0)


def _too_low(file: Path, end: float, lowest: dict[PointDemand, tuple[float, float | None]]) -> str:
    shared, (there, height) = min(lowest.items(), key=lambda one: one[1][0])
    stop, tall = shared.stop.fill_height, height or shared.height_ahead
    assert stop is not None
    assert tall is not None
    start = shared.study.window.start
    earlier = f" a window.end below {there:.2f}," if there > start + 0.01 else ""
    how = "is" if height else f"will be, at a packing fraction of {PACKED},"
    fallen, _ = told_apart(100 * there, 100 * end, digits=2)
    reason = (
        f"the bed {how} {tall * 1e3:.3g} mm high and has fallen to {stop * 1e3:.4g} mm "
        f"with {fallen} % discharged, before the window ends (window.end, {end:g}), at {_named(lowest)}"
    )
    remedy = f"use a stop.fill_height below {(1 - end) * tall * 1e3:.3g} mm,{earlier} or more grains"
    return _told(file, "stop.fill_height", reason, remedy)


def _narrow(file: Path, points: Sequence[tuple[PointDemand, Outline]]) -> Iterator[str]:
    def narrow(shared: PointDemand, one: Outline) -> bool:
        return one.ratio is not None and one.ratio < NARROW[shared.scene.grains.shape] * (1 - 1e-9)

    few = [(shared, one) for shared, one in points if narrow(shared, one)]
    if few:
        shared, one = min(few, key=lambda pair: pair[1].ratio or 0)
        rods = shared.scene.grains.half_length > 0
        what = "lengths of a rod" if rods else "diameters of a grain"
        least = NARROW[shared.scene.grains.shape]
        ratio, bound = told_apart(one.ratio or 0.0, least, digits=2)
        what = "length of a rod" if rods and ratio == "1" else "diameter of a grain" if ratio == "1" else what
        reason = f"the outlet is {ratio} {what} wide ({one.extent * 1e3:.3g} mm), and below {bound} it often clogs"
        enough = math.ceil(least * one.extent * 1e4 * (1 - 1e-9)) / 10  # mm
        yield _told(file, "container.orifice", reason, f"use {enough:g} mm or more", few, points)


def _overfull(file: Path, points: Sequence[tuple[PointDemand, Outline]]) -> Iterator[str]:
    over = [
        (shared, one)
        for shared, one in points
        if one.height is not None and one.height > getattr(shared.scene.container, "height", math.inf)
    ]
    if over:
        shared, one = max(over, key=lambda pair: pair[1].height or 0)
        height, top = one.height or 0.0, float(getattr(shared.scene.container, "height", math.inf))
        high, walls = told_apart(height * 1e3, top * 1e3)
        stand = f"the grains will stand about {high} mm high, at a packing fraction of {PACKED}"
        reason = f"{stand}, above the walls ({walls} mm)"
        remedy = f"make the container {float(f'{1.1e3 * height:.3g}'):g} mm high or more, or lower grains.count"
        yield _told(file, "container.height", reason, remedy, over, points)


def _alike(plan: Plan) -> Iterator[str]:
    """Points whose runs are those of another one: what differs between them changes nothing."""
    alike: dict[str, list[Point]] = {}
    for one in plan.points:
        if one.items:
            alike.setdefault(one.items[0].keys.run, []).append(one.shared.point)
    told: dict[str, list[Point]] = {}
    for points in alike.values():
        for key in points[0].at:
            if len({point.at.get(key) for point in points}) > 1:
                told.setdefault(key, points)
    for key, points in told.items():
        same = "; ".join(point.label for point in points[:3]) + (" ..." if len(points) > 3 else "")
        reason = f"it changes nothing here: these points are the same runs, and would count as several ({same})"
        yield _told(plan.study.path, key, reason, "leave it out, or vary a key that the runs depend on")


def _of_fillings(study: Study) -> Iterator[str]:
    """Walls that stand only while the bed is filled, and have properties that the flow will not know."""
    found: dict[str, list[str]] = {}
    for scene in (point.scene for point in study.points):
        standing = [wall.name for wall in scene.container.walls()]
        for name in scene.walls:
            if name != "all" and name not in standing:
                found[name] = [other for other in standing if other.startswith(name)] or standing
    for name, standing in found.items():
        reason = "this wall stands only while the bed is filled: the flow does not feel it"
        yield _told(study.path, f"walls.{name}", reason, f"for the flow use {', '.join(standing)}")


def _leaky(plan: Plan) -> Iterator[str]:
    """Containers that may lose grains while they are filled, which only the filling will show."""
    for point in plan.points:
        found = leak_of(point.shared)
        if found is not None:
            d = point.shared.scene.grains.finest
            reason = (
                "whether grains reach it while the container is filled cannot be told: gaps about as wide as a grain "
                f"({d * 1e3:.3g} mm) were looked for on a grid of {found.spacing * 1e3:.2g} mm, and one may be at "
                f"{found.place}"
            )
            remedy = "make gaps clearly narrower or wider than the smallest grain; a filling that loses grains fails"
            yield _told(plan.study.path, "container.outlet_plane", reason, remedy)
            return


def _ringed(study: Study) -> Iterator[str]:
    """Cylinders with so little bottom around the outlet that W does not follow from the outlet alone."""
    silos = [(point, point.scene.container) for point in study.points if point.scene.grains.shape == "sphere"]
    rings = [
        ((silo.diameter - silo.orifice) / 2 / point.scene.grains.diameter, point, silo)
        for point, silo in silos
        if isinstance(silo, CylinderSilo)
    ]
    narrow = [ring for ring in rings if ring[0] < RING * (1 - 1e-9)]
    if narrow and "flow_rate" in study.measure:
        width, point, silo = min(narrow, key=lambda ring: ring[0])
        rows, bound = told_apart(width, RING, digits=3)
        reason = (
            f"the bottom around the outlet of {1e3 * silo.orifice:g} mm is {rows} diameters of a grain wide: below "
            f"{bound} W depends on rows of grains at the wall, scatters, and is not smooth in the outlet"
        )
        wide = silo.orifice + 2 * RING * point.scene.grains.diameter
        remedy = f"use {math.ceil(1e3 * wide * (1 - 1e-9)):g} mm or more, or narrower outlets"
        yield _told(study.path, "container.diameter", reason, remedy)


def _low(study: Study) -> Iterator[str]:
    """Beds that are too low for a steady flow when the window ends, in a study that leaves that to labbook."""
    if study.fed or study.window.timed or "end" in study.stated.get("window", {}) or "flow_rate" not in study.measure:
        return
    low = [(point, until) for point in study.points
           if (until := high_until(point.scene)) is not None and until < study.window.end - 1e-9]  # fmt: skip
    if low:
        point, until = min(low, key=lambda one: one[1])
        count = point.scene.grains.count
        enough = count * (1 - until) / (1 - study.window.end)
        step = 10 ** max(0, math.floor(math.log10(enough)) - 1)
        reason = (
            f"the bed is less than {HIGH:g} widths high before the window ends, at {percent(study.window.end)} "
            "discharged: W may fall with it"
        )
        remedy = f"use {math.ceil(enough / step) * step:.0f} grains or more, or state window.end"
        yield _told(study.path, "grains.count", reason, remedy)


def _empty(study: Study, points: Sequence[tuple[PointDemand, Outline]]) -> Iterator[str]:
    """Measures that will probably give no number."""
    for name in study.measure:
        found = [(pair, why) for pair in points if (why := MEASURES[name].foreseen_empty(pair[0].scene))]
        if not found:
            continue
        (_, (reason, remedy)), at = found[0], [pair for pair, _ in found]
        laws = [law for law in study.fit if law in LAWS and LAWS[law].of_bulk]
        if name == PackingStructure.name and laws and len(at) == len(points):
            lost = (f"{symbol} of {law}" for law in laws for symbol in LAWS[law].of_bulk)
            reason += f"; without a packing fraction there is no {', no '.join(lost)}"
        yield _told(study.path, "measure", f"{name} will probably be empty: {reason}", remedy, at, points)


def _endless(plan: Plan) -> Iterator[str]:
    """Runs that nothing leaves, and that go on for as long as stop.max_time has by default."""
    closed = all(point.scene.container.outlet_plane is None for point in plan.study.points)
    if not closed or plan.study.stop.max_time is not None:
        return
    longest = max(point.shared.stop.max_time for point in plan.points)
    reason = f"this container has no outlet, so every run lasts {longest:.3g} s"
    remedy = "state stop.max_time; for measurements of the packing alone, 10 ms are enough"
    yield _told(plan.study.path, "stop.max_time", reason, remedy)


def _undamped(plan: Plan) -> Iterator[str]:
    """Fillings that lose energy by friction alone: 300 spheres with a friction of 0.5 still hovered at 1e-4 m g d after
    7 s, where those with a restitution of 0.2 rest within 1 s."""
    for point in plan.study.points:
        if (at_fault := undamped(point)) is not None:
            key, remedy = at_fault
            reason = "impacts lose no energy while the bed is filled: by friction alone it rests late, or never"
            yield _told(plan.study.path, key, reason, remedy)
            return


def _too_few_grains(plan: Plan) -> Iterator[str]:
    """Windows in which too few grains leave for a flow rate, however the bed flows."""
    study = plan.study
    window, stop = study.window, study.stop
    if QUANTITY not in study.measure or window.timed or study.fed:
        return
    part = min(window.end, stop.discharged) - window.start
    few = min(point.scene.grains.count for point in study.points)
    if few * part <= FEWEST:
        reason = (
            f"of {few} grains {max(0, int(few * part))} leave between {percent(window.start)} and "
            f"{percent(window.start + part)}, and a flow rate needs more than {FEWEST}"
        )
        more = f"use {math.ceil(1.1 * FEWEST / part / 50) * 50} grains or more, or " if part > 0 else ""
        yield _told(study.path, "grains.count", reason, f"{more}widen window")


def _too_few_outlets(plan: Plan) -> Iterator[str]:

    outlets: dict[tuple, set[float]] = defaultdict(set)
    for point in plan.study.points:
        others = tuple((key, value) for key, value in point.at.items() if key != "container.orifice")
        outlets[others].add(float(getattr(point.scene.container, "orifice", math.nan)))
    fewest = min(map(len, outlets.values()))
    short = [name for name in plan.study.fit if name in LAWS and len(LAWS[name].free) >= fewest]
    if short:
        needed = max(len(LAWS[name].free) for name in short) + 1
        parameters = ", ".join(f"{name} has {len(LAWS[name].free)} parameters" for name in short)
        reason = f"{fewest} {'orifice is' if fewest == 1 else 'orifices are'} too few: {parameters}"
        yield _told(plan.study.path, "fit", reason, f"sweep {needed} or more values of container.orifice")


def _heavy(plan: Plan) -> Iterator[str]:
    """Recordings that fill disk and memory."""
    largest = max((point.shared for point in plan.points), key=film_bytes)
    if (taken := film_bytes(largest)) > _HEAVY and (every := largest.frame_interval) is not None:
        enough = span(float(f"{every * taken / _HEAVY:.1g}"))
        reason = f"a recorded run takes about {size(taken)} on disk, and is read as a whole for pictures and fields"
        yield _told(plan.study.path, "record.every", reason, f"with {enough} it takes about {size(_HEAVY)}")


def _stiff(study: Study, points: Sequence[tuple[PointDemand, Outline]]) -> Iterator[str]:
    """Grains much stiffer than their bed needs, which costs steps."""
    found = []
    by_youngs = "youngs_modulus" in study.stated.get("contact", {})
    for shared, one in points:
        scale = shared.numerics.stiffness_scale
        youngs = by_youngs or "contact.youngs_modulus" in shared.point.at
        told = softer(shared.scene.stiffened(scale), one.height, youngs) if one.height else None
        if told:
            key, soft, unit, times = told
            found.append((key, soft / scale, unit, times))  # the study states stiffness before it is scaled
    if found:
        key, soft, unit, times = max(found, key=lambda one: one[-1])
        reason = f"grains this stiff take {times:.2g} times as many steps as the weight of the bed requires"
        remedy = f"with {_rounded(soft)} {unit} grains overlap by at most about {percent(SOFT)} of d"
        yield _told(study.path, key, reason, remedy)


def _soft(study: Study, points: Sequence[tuple[PointDemand, Outline]]) -> Iterator[str]:
    """Grains so soft that the weight of their bed alone overlaps them by more than the guard allows."""
    by_youngs = "youngs_modulus" in study.stated.get("contact", {})
    for shared, one in points:
        numerics = shared.filled_by
        scene = shared.scene.stiffened(numerics.stiffness_scale)
        grains = scene.grains
        youngs = by_youngs or "contact.youngs_modulus" in shared.point.at
        for where, by_e, law in _stiffnesses(scene, youngs) if one.height else ():
            pressure = _pressure(scene, one.height or 0.0)
            overlap, hard = law.overlap(pressure, grains.diameter), law.softer(pressure, SOFT, grains.diameter)
            if overlap is None or hard is None or overlap <= numerics.overlap_limit:
                continue
            key, enough = _stated(hard, by_e)
            reason = (
                f"under the weight of the bed grains this soft overlap by about {overlap:.2g} d, and runs end at "
                f"{numerics.overlap_limit:g} d (numerics.overlap_limit)"
            )
            remedy = f"with {_rounded(enough / numerics.stiffness_scale)} {hard.unit} it is {percent(SOFT)} of d"
            yield _told(study.path, f"{where}.{key}", reason, remedy)
            return


def softer(scene: Scene, height: float, youngs: bool = False) -> tuple[str, float, str, float] | None:
    """A stiffness at which grains overlap by SOFT d below a bed of the height [m]: key, value, unit, and how many times
    fewer steps it takes; None where that is less than a few. Where stiffness differs: of the stiffest.

    youngs: whether the study states E in `contact`; the scene has G. A step goes as one over the root of the stiffness.
    """
    pressure, d = _pressure(scene, height), scene.grains.diameter
    found = [(where, by_e, law.softer(pressure, SOFT, d)) for where, by_e, law in _stiffnesses(scene, youngs)]
    told = [(where, by_e, one) for where, by_e, one in found if one is not None and one.enough > 0]
    if not told:
        return None
    where, by_e, one = max(told, key=lambda each: each[2].stated / each[2].enough)
    key, enough = _stated(one, by_e)
    times = math.sqrt(one.stated / one.enough)
    return (f"{where}.{key}", enough, one.unit, times) if times > _SLOWER else None


def _pressure(scene: Scene, height: float) -> float:
    """p = phi rho g H [Pa] at the foot of a bed of the height H [m], which presses grains with p d^2 together."""
    return PACKED * scene.grains.mean_density * scene.gravity * height


def _stated(one: Softer, by_e: bool) -> tuple[str, float]:
    """The key in which a study states a stiffness, and how much of that is enough. by_e: it states Young's modulus."""
    key, ratio = one.other if by_e and one.other else (one.key, 1.0)
    return key, one.enough * ratio


def _stiffnesses(scene: Scene, youngs: bool) -> Iterator[tuple[str, bool, ContactLaw]]:
    """Sections that state how stiff grains are, whether by Young's modulus, and the law of their contacts. Walls of
    another material are left out: contacts with them are at most twice as stiff as those of grains."""
    kinds = range(len(scene.grains.species))
    own = "contact.between[]" if scene.contact.material is None else "grains.kinds[]"
    for one in kinds:
        by_e = bool(scene.grains.kinds) and scene.grains.kinds[one].youngs_modulus is not None
        for other in kinds[: one + 1] if scene.contact.material is None else (one,):
            law = scene.law_between(one, other)
            yield ("contact", youngs, law) if law == scene.contact else (own, by_e, law)
        for wall in scene.container.walls() if scene.contact.material is None else ():
            if (law := scene.law(wall, one)) != scene.law_between(one, one):
                here = scene.walls.get(wall.name)
                stated = wall.name if here is not None and here.normal_stiffness is not None else "all"
                yield f"walls.{stated}", False, law


def _rounded(value: float) -> str:
    return f"{float(f'{value:.1g}'):g}"


def _told(
    file: Path,
    key: str,
    reason: str,
    remedy: str,
    at: Sequence[tuple[PointDemand, Outline]] = (),
    among: Iterable[object] = (),
) -> str:
    where = f" (at {_named(shared for shared, _ in at)})" if 0 < len(at) < len(list(among)) else ""
    return f"{file}: {key}: {reason}{where}\n    remedy: {remedy}"


def _named(points: Iterable[PointDemand]) -> str:
    labels = [shared.point.label for shared in points]
    return f"{'; '.join(labels[:_NAMED])}{and_others(len(labels) - _NAMED)}"
