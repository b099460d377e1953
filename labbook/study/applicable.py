"""Checks that the scenes of a study allow its measurements, its laws and the numbers of its reference."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

from labbook.filling import PlacingError, Pouring, from_file
from labbook.filling.placing import STARTS
from labbook.fit import LAWS
from labbook.measure import MEASURES, MeasureError
from labbook.measure.outlets import OutletRates
from labbook.scene.container_shape import ContainerShape
from labbook.scene.model import Fault
from labbook.scene.quantities import format_distinct
from labbook.scene.scene import Scene
from labbook.scene.timescales import gravity_time, stop_time
from labbook.scene.wall_bins import is_upright
from labbook.study.paper import PAPERS, QuantityContext, Wrong, none_such
from labbook.study.point import Point
from labbook.study.problems import Problem
from labbook.study.schema import STALL, Settings, Window
from labbook.study.source import StudyText


def unmeasurable(source: StudyText, settings: Settings, points: Sequence[Point]) -> Iterator[Problem]:
    """Measurements that some points do not allow."""

    def why(name: str, scene: Scene) -> tuple[str, str] | None:
        try:
            MEASURES[name].check(scene)
        except MeasureError as error:
            return error.reason, error.remedy
        return None

    yield from _unfit(source, "measure", [n for n in settings.measure if n in MEASURES], points, why)


def unfittable(source: StudyText, settings: Settings, points: Sequence[Point]) -> Iterator[Problem]:
    """Laws that do not apply to the outlets of some points."""

    def why(name: str, scene: Scene) -> tuple[str, str] | None:
        of, outlet = LAWS[name].outlet, scene.container.outlet_form
        if len(scene.container.outlets) > 1 and OutletRates.name in settings.measure:
            forms = {one.form for one in scene.container.outlets if one.form is not None}
            if forms if of == "any" else of in forms:
                return None
            outlet = min(forms, default=None)
        if outlet is None:
            reason = f"{name} needs the orifice of a hopper or silo, but the container is {scene.container.kind}"
            return (
                reason,
                f"remove {name} from fit, or use a hopper or silo, or several lids with measure: [flow_rate, outlets]",
            )
        if of in (outlet, "any"):
            return None
        family = name.removesuffix("_3d")
        alternatives = [law for law in LAWS if law.removesuffix("_3d") == family and LAWS[law].outlet == outlet]
        return (
            f"{name} is a law for a {of}, but the outlet is a {outlet}",
            f"use {' or '.join(alternatives)}" if alternatives else f"remove {name} from fit",
        )

    yield from _unfit(source, "fit", [name for name in settings.fit if name in LAWS], points, why)


PLAY = 1e-5
"""Smallest play between a grain and its container, as a fraction of d, that allows placing the grain."""
LOOSEST = 0.3
"""Lower bound of the packing fraction of a settled bed: it gives an upper bound of the height of the bed."""


def unfillable(source: StudyText, settings: Settings, points: Sequence[Point]) -> Iterator[Problem]:
    """Scenes that cannot be filled, and values of `stop.fill_height` that no bed reaches.

    A scene needs gravity, room for a grain, and a start of the filling that suits it.
    """
    reported = set[str]()
    for point in points:
        start = (*STARTS[point.fill.kind].obstacles(point.scene), *_file_faults(point, settings))
        obstacles = (
            *_obstacles(point.scene),
            *_restless(point),
            *_immobile(point),
            *_too_high(point.scene, settings.stop.fill_height),
            *_unrested(point, settings.measure),
            *_blocked(point),
        )
        for key, reason, remedy in (*obstacles, *((one.key, one.reason, one.remedy) for one in start)):
            if key not in reported:
                reported.add(key)
                at = f" (at {point.label})" if len(points) > 1 else ""
                location = tuple(key.split("."))
                for swept in (("sweep", key), ("sweep", "zip", key), location):
                    if swept in source.lines or swept is location:
                        yield Problem(source.path, source.line(swept), key, reason + at, remedy)
                        break


def unfed(source: StudyText, settings: Settings, points: Sequence[Point], window: Window) -> Iterator[Problem]:
    """Keys about falling beds in a study of fed beds; without feed, a `window` that ends before or at its start."""
    fed = [point for point in points if point.scene.feed is not None]
    if not fed:
        start, end = settings.window.start, window.end
        if end <= start:
            reason = f"the window starts at {start:g}, but its default end is {end:g}"
            yield Problem(source.path, source.line(("window",)), "window.end", reason, f"state an end above {start:g}")
        return
    if len(fed) < len(points):
        reason = "some points have a feed and others have none: their windows and stop rules differ"
        yield Problem(source.path, source.line(("feed",)), "feed", reason, "use two studies")
    stop, window_keys = settings.stop.model_fields_set, settings.window.model_fields_set
    never = "the level of a fed bed never falls"
    for key in sorted(stop & {"discharged", "fill_height"}):
        remedy = "leave it out: runs end when accuracy.flow_rate is reached, or at stop.max_time"
        yield Problem(source.path, source.line(("stop", key)), f"stop.{key}", never, remedy)
    if window.auto:
        reason = "auto finds the start-up of a discharge, and the flow of a fed bed changes until half of it has left"
        yield Problem(source.path, source.line(("window", "start")), "window.start", reason, "state it, such as 0.5")
    for key in sorted(window_keys & {"end", "after", "until"}):
        reason = f"{never}: the window opens after the start-up, by mass, and closes when the run ends"
        remedy = "leave it out, or state window.start alone"
        yield Problem(source.path, source.line(("window", key)), f"window.{key}", reason, remedy)


def undivided(source: StudyText, settings: Settings, points: Sequence[Point]) -> Iterator[Problem]:
    """An `accuracy.clogging` of a container with several outlets, each of which has its own probability."""
    if settings.accuracy.clogging is not None and any(len(point.scene.container.outlets) > 1 for point in points):
        reason = "the container has several outlets, each with its own probability of a stop"
        remedy = "leave it out, and state replicates"
        yield Problem(source.path, source.line(("accuracy", "clogging")), "accuracy.clogging", reason, remedy)


def unbroken(source: StudyText, settings: Settings, points: Sequence[Point]) -> Iterator[Problem]:
    """A `restart.wait` that is not shorter than `stop.stall`, which ends runs; and a `stop.still` beside a restart, or
    without an outlet about which grains can be still."""
    for point in points:
        reason = ""
        if settings.stop.still and point.scene.restart is not None:
            reason = "a still outlet ends the run, before its arch is broken"
        elif settings.stop.still and [math.isfinite(o.width) for o in point.scene.container.outlets] != [True]:
            reason = "the container has not one outlet of a known width"
        if reason:
            yield Problem(source.path, source.line(("stop", "still")), "stop.still", reason, "leave it out")
            return
        if point.scene.restart is None:
            continue
        wait, stall = stop_time(point.scene), settings.stop.stall or STALL * gravity_time(point.scene)
        if wait >= stall:
            reason = (
                f"a run ends as clogged {stall:.4g} s after its last grain, before an arch is broken ({wait:.4g} s)"
            )
            remedy = f"use a restart.wait below {stall:.4g} s, or a longer stop.stall"
            yield Problem(source.path, source.line(("restart",)), "restart.wait", reason, remedy)
            return


def unadaptable(source: StudyText, settings: Settings, points: Sequence[Point]) -> Iterator[Problem]:
    """Obstacles of the strategy under `adapt`, such as a range that no sweep states."""
    if settings.adapt is None or not points:
        return
    for fault in settings.adapt.obstacles(settings.measure, points):
        location = ("adapt", *fault.key.split("."))
        yield Problem(source.path, source.line(location), ".".join(location), fault.reason, fault.remedy)


def undischarged(source: StudyText, settings: Settings, points: Sequence[Point]) -> Iterator[Problem]:
    """Several discharges of a bed at points where a bed has one run at most."""
    if settings.discharges_per_bed == 1:
        return
    key, remedy = "discharges_per_bed", "leave it out, and use replicates: each has a bed of its own"
    for point in points:
        reason = ""
        if point.scene.feed is not None:
            reason = "one run of a fed bed goes on until its own flow rate is known"
        elif point.scene.container.outlet_plane is None:
            reason = "the container has no outlet, so that nothing is discharged"
        if reason:
            at = f" (at {point.label})" if len(points) > 1 else ""
            yield Problem(source.path, source.line((key,)), key, reason + at, remedy)
            return


def _obstacles(scene: Scene) -> Iterator[tuple[str, str, str]]:
    if scene.gravity == 0:
        yield "gravity", "without gravity the grains do not settle", "use a gravity above 0 m/s^2"
    d, sizes = scene.grains.diameter, vars(scene.container)
    for name in ("thickness", "width", "depth", "diameter"):
        size = sizes.get(name, math.inf)
        if d <= size < d * (1 + PLAY):
            reason = f"the {name} equals the grain diameter, which leaves no room to place grains"
            yield f"container.{name}", reason, "use 1.01 d or more"


def undamped(point: Point) -> tuple[str, str] | None:
    """The key at fault and the remedy where no impact loses energy while the bed is filled; None where some do."""
    closed = point.scene.close(point.fill.friction, point.fill.contact)
    if any(closed.contact.damps(surface.restitution) for surface in closed.surfaces):
        return None
    has_damping = getattr(closed.contact, "normal_damping", None) is not None
    key, better = ("normal_damping", "above 0") if has_damping else ("restitution", "below 1")
    section = "contact" if point.fill.contact is None else "fill.contact"
    own = "" if point.fill.contact is not None else "; fill.contact may state another law for the filling alone"
    return f"{section}.{key}", f"use a {key.replace('_', ' ')} {better}{own}"


def _file_faults(point: Point, settings: Settings) -> Iterator[Fault]:
    """Reasons against a start from a file: of the file, and requests for more than one bed."""
    fill = point.fill
    if fill.grain_file is None:
        return
    yield from from_file.faults(point.scene.close(fill.friction, fill.contact), fill.grain_file)
    reason, several = "a file is one bed, and replicates of it would be the same run", "discharges_per_bed"
    remedy = f"use {several}: 3 or more, which discharges this bed several times"
    if settings.replicates > 1:
        yield Fault("replicates", reason, remedy)
    accuracy = settings.accuracy
    if accuracy.clogging is not None or (accuracy.flow_rate is not None and point.scene.feed is None):
        key = "flow_rate" if accuracy.clogging is None else "clogging"
        yield Fault(f"accuracy.{key}", f"an error is reached by more beds, and {reason}", remedy)
    if settings.adapt is not None:
        yield Fault("adapt", f"a strategy asks for more beds, and {reason}", "leave it out, or use another start")


def _restless(point: Point) -> Iterator[tuple[str, str, str]]:
    """A bed whose filling keeps its energy. Rolling friction takes none from spheres that no friction can turn."""
    if (at_fault := undamped(point)) is None:
        return
    closed = point.scene.close(point.fill.friction, point.fill.contact)
    rods = not closed.grains.round
    if not any(surface.friction > 0 or (rods and surface.rolling_friction > 0) for surface in closed.surfaces):
        key, remedy = at_fault
        yield key, "neither impacts nor friction lose energy, so that the bed never comes to rest", remedy


def _immobile(point: Point) -> Iterator[tuple[str, str, str]]:
    """A container without upright walls whose friction could be mobilised."""
    if point.fill.mobilise is None or any(map(is_upright, point.scene.container.close().walls())):
        return
    yield "fill.mobilise", "the container has no upright wall", "leave it out"


def _too_high(scene: Scene, stop: float | None) -> Iterator[tuple[str, str, str]]:
    area = flat_area(scene.container)
    if stop is None or area is None:
        return
    highest = scene.grains.count * scene.grains.volume / (LOOSEST * area)
    if stop >= highest:
        height, upper = format_distinct(stop * 1e3, highest * 1e3, digits=6, of_limit=3)
        bound = f"at most {upper} mm, at a packing fraction of {LOOSEST:g}"
        reason = f"{height} mm is above any bed of these grains ({bound})"
        yield "stop.fill_height", reason, f"use less than {highest / 2 * 1e3:.3g} mm, or more grains"


def _unrested(point: Point, measures: Sequence[str]) -> Iterator[tuple[str, str, str]]:
    """Measures of a bed at rest, where the outlet opens at a time that is stated, and of all grains from the start on,
    where a stream goes on."""
    until, stream = point.fill.until, point.fill.stream
    if until is None:
        return
    for name in ("packing", "wall_stress"):
        if name in measures:
            reason = f"{name} is measured in a bed at rest, and this one may move when the outlet opens"
            yield "fill.until", reason, f"leave it out, or take {name} out of measure"
    if stream is None or stream.time(point.scene.grains) <= until:
        return
    for name in measures:
        if name in MEASURES and MEASURES[name].needs_all:
            reason = f"{name} needs all grains in the container at the opening, and the stream brings some later"
            yield "fill.until", reason, f"use a later time or a larger rate, or take {name} out of measure"
    if point.scene.feed is not None:
        yield "fill.until", "grains of the stream and of the feed would enter at once", "leave feed out"


def _blocked(point: Point) -> Iterator[tuple[str, str, str]]:
    """Streams that bring no grain."""
    feed = point.scene.feed
    for section, stream in (("fill", point.fill.stream), ("feed", None if feed is None else feed.stream)):
        if stream is None:
            continue
        try:
            Pouring(point.scene.close(), stream, 1, point.numerics.beat).first()
        except PlacingError as error:
            reason, _, remedy = str(error).partition("; ")
            yield f"{section}.stream", reason, remedy


def flat_area(container: ContainerShape) -> float | None:
    """Area [m^2] of the bottom of a flat-bottomed silo; None of other containers."""
    return container.area if container.outlets and container.rise == 0 else None


def _unfit(
    source: StudyText,
    key: str,
    names: Iterable[str],
    points: Sequence[Point],
    why: Callable[[str, Scene], tuple[str, str] | None],
) -> Iterator[Problem]:
    for name in names:
        wrong: dict[tuple[str, str], list[Point]] = {}
        for point in points:
            if fault := why(name, point.scene):
                wrong.setdefault(fault, []).append(point)
        for (reason, remedy), at in wrong.items():
            raw = source.data.get(key)
            listed = (key, raw.index(name)) if isinstance(raw, list) and name in raw else (key,)
            location = listed if raw else ("container", "kind")
            rest = f" and {len(at) - 1} other point{'' if len(at) == 2 else 's'}" if len(at) > 1 else ""
            where = f" (at {at[0].label}{rest})" if len(at) < len(points) else ""
            yield Problem(source.path, source.line(location), key, reason + where, remedy)


def unit_of(quantity: str, settings: Settings, scenes: Iterable[Scene], is_statement: bool = False) -> str | Wrong:
    """SI unit of the `quantity` of a reference, in a study with these settings and scenes; Wrong if it has none.

    stated: whether the reference gives a range instead of a number.
    """
    head, _, tail = quantity.partition(".")
    kinds = tuple({_kind(scene): scene for scene in scenes}.values())
    units = _units_of(settings.measure, kinds)
    if head in LAWS:
        parameters: Mapping[str, str] = {name: one.unit for name, one in LAWS[head].parameters.items()}
        if head not in settings.fit:
            return Wrong(f"{head} is not fitted in this study", f"add {head} to fit")
        return (
            parameters[tail] if tail in parameters else none_such(quantity, [f"{head}.{name}" for name in parameters])
        )
    name = tail or head
    if name in units and (not tail or head in settings.measure):
        return units[name]
    context = QuantityContext(kinds, units, is_statement)
    for paper in PAPERS.values():
        if (unit := paper.unit(quantity, context)) is not None:
            return unit
    if head in MEASURES and head not in settings.measure:
        return Wrong(f"{head} is not measured in this study", f"add {head} to measure")
    prefix = f"{head}." if tail and head in MEASURES else ""
    return none_such(quantity, [prefix + one for one in units])


def _kind(scene: Scene) -> tuple:
    """Properties that determine the quantities of a scene."""
    c, grains = scene.container, scene.grains
    thin = c.front_to_back < 2 * grains.diameter
    return c.kind, grains.round, grains.elongated, grains.varied, thin, len(c.outlets), c.planes, c.zones


def _units_of(measures: Iterable[str], scenes: Iterable[Scene]) -> dict[str, str]:
    known_measures = [MEASURES[name] for name in measures if name in MEASURES]
    return {
        quantity.name: quantity.unit
        for scene in scenes
        for measure in known_measures
        for quantity in measure.quantities(scene)
    }
