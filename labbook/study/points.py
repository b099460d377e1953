"""From the sections of a study, with one point's values put in, to that point: scene, filling and numerics."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from dataclasses import replace
from hashlib import blake2b
from typing import Any, TypeVar

from pydantic import BaseModel, TypeAdapter, ValidationError

from labbook.accuracy import Calibration, Choice, NotMeasured, OutOfRange, choose
from labbook.backend.numerics import Numerics
from labbook.scene.grains import Grains, Spheres
from labbook.scene.model import Model, once
from labbook.scene.scene import Scene
from labbook.study.explain import Complaint, complaints
from labbook.study.point import Point, value_of
from labbook.study.problems import Problem, and_others, shown
from labbook.study.schema import SCENE_KEYS, Fill, Settings
from labbook.study.source import Location, StudyText, dotted
from labbook.study.sweep import Assignment, Value
from labbook.study.timestep import TimeStepError, numerics_for, speed_limit

MAX_WRONG = 500
"""After this many points that are wrong, the rest are not looked at: they repeat the same mistakes."""

_PARTS = ("container", "contact", "feed")
"""Sections of a scene that are models of their own."""
_OWN = ("walls.", "fill.")
_NUMERICS, _FILLING = ("numerics",), ("fill", "numerics")
_STEPS = ((*_NUMERICS, "dt"), (*_FILLING, "dt"))
_SOFTENED = {"flow_rate", "packing"}
"""Measures of which the calibration says what softer grains do to them; with others stiffness is left as stated."""
_GRAINS = TypeAdapter(Grains)
_PLACEHOLDER = Spheres(diameter=1e-3, density=1e3, count=1)  # stands in for grains that are wrong

_P = TypeVar("_P", bound=Model)


class PointReader:
    """Validates points and collects what is wrong with them."""

    def __init__(
        self,
        source: StudyText,
        wrong_already: Set[str | None],
        settings: Settings | None,
        calibration: Calibration | None = None,
    ):
        """`wrong_already`: keys of which it is known that they are misspelled, or that their sweep is wrong;
        `settings`: what the study states once, None if that is wrong; `calibration`: its own, None for the one that
        ships."""
        self._source, self._settings, self._calibration = source, settings, calibration
        self._wrong_already = wrong_already
        self._found: dict[Problem, list[str]] = {}
        self._ready: dict[Any, Any] = {}
        """Parts of points that are right, by the values that were put into their sections: most points share theirs."""
        self._parts: dict[frozenset[str], tuple[set[str], dict[Model, Model]]] = {}
        """The same by the keys that are stated: these keys, and parts by what they are."""

    @property
    def problems(self) -> Iterator[Problem]:
        """What is wrong, each once, with the points that it is wrong at."""
        for problem, labels in self._found.items():
            where = f" (at {labels[0]}{and_others(len(labels) - 1)})" if labels else ""
            yield replace(problem, message=problem.message + where)

    def read(self, assignments: Iterable[Assignment]) -> tuple[Point, ...]:
        """All points that are right. A point that repeats another is a problem."""
        wrong, points = 0, list[Point]()
        seen: dict[bytes, str] = {}
        by_keys: dict[tuple[str, ...], _Keys] = {}
        for assignment in assignments:
            swept = tuple(assignment)
            keys = by_keys.get(swept) or by_keys.setdefault(swept, _Keys(swept))
            label = keys.label(assignment)
            point = self._point(len(points), assignment, keys, label)
            if point is None:
                wrong += 1
                if wrong == MAX_WRONG:
                    break
                continue
            stated = "\n".join((point.scene.model_dump_json(), _json(point.fill), _json(point.numerics)))
            identity = blake2b(stated.encode(), digest_size=16).digest()
            if identity in seen:
                key, value = next(iter(assignment.items()), ("points", None))
                line = value.line if value else self._source.line(("points",))
                message = f"the point {label} repeats the point {seen[identity]}"
                self._found[Problem(self._source.path, line, key, message, "leave one of them out")] = []
                continue
            seen[identity] = label
            points.append(point)
        return tuple(points)

    def _point(self, index: int, assignment: Assignment, keys: "_Keys", label: str) -> Point | None:
        found: list[Complaint] = []
        raw = _assign(self._source.data, assignment)
        of = keys.sections(assignment)
        grains = self._once(("grains", of.get("grains")), lambda: self._grains(raw, found))
        diameter = (grains or _PLACEHOLDER).diameter
        context = {"units": "required", "d": diameter}
        scene, near = self._scene(raw, of, grains, context, found)
        stated, filling = _apart(raw.get("fill", {}), "numerics")
        fill: Fill | None = self._once(
            ("fill", of.get("fill"), diameter), lambda: _validated(Fill, stated, context, ("fill",), found)
        )
        closed = None
        if near is not None and fill is not None and fill.contact is not None:
            faults = tuple(near.faults_of_law(fill.contact))
            found += [Complaint(("fill", *fault.key.split(".")), fault.reason, fault.remedy) for fault in faults]
            closed = None if faults else near.close(fill.friction, fill.contact)
        general = raw.get("numerics", {})
        flowing = closed if filling is None else None  # a step of its own is for the filling alone
        # the step hangs on a container only where its walls differ from the grains, by their names
        walls = tuple(wall.name for one in (near, flowing) if one and one.walls for wall in one.container.walls())
        sections = tuple([of.get(name) for name in ("numerics", "fill", "grains", "contact", "walls", "gravity")])
        numerics = self._once(
            (sections, walls) if scene is not None else None,
            lambda: self._numerics({}, general, near, flowing, context, found, _NUMERICS),
        )
        choice, unmet = None, None
        if numerics is not None and scene is not None and fill is not None and filling is None:
            choice, unmet = self._chosen(scene, fill, general, numerics)
        if choice is not None and numerics is not None:
            chosen = {key: getattr(choice, key) for key in ("dt", "stiffness_scale", "precision")}
            numerics = numerics.model_copy(update=chosen)
        if numerics is not None and scene is not None:
            numerics = _guarded(numerics, general, scene)
        if filling is not None and fill is not None and numerics is not None:
            fill = self._filled(fill, filling, general, numerics, near, closed, context, found)
        if scene is None:
            found = [complaint for complaint in found if complaint.location not in _STEPS or not complaint.clash]
        for complaint in found:
            # with grains that stand in for wrong ones, values clash that need not
            may_be_right = complaint.clash and grains is None and complaint.location[0] != "grains"
            if not may_be_right and dotted(complaint.location) not in self._wrong_already:
                places = self._found.setdefault(self._problem(complaint, assignment), [])
                if complaint.clash and label:
                    places.append(label)
        if found or scene is None or fill is None or numerics is None:
            return None
        named = self._settings is not None and self._settings.accuracy.calibration is not None
        piloted = isinstance(unmet, NotMeasured) and "dt" not in general and not named
        why = "" if unmet is None else str(unmet)
        fill, numerics = self._shared(fill), self._shared(numerics)
        at = {key: value for key in assignment if (value := value_of(key, scene, fill, numerics)) is not None}
        return Point(index, scene, fill, numerics, at, label or "the only point", choice, why, piloted)

    def _once(self, of: tuple | None, read: Callable[[], _P | None]) -> _P | None:
        """A part of a point: the one that was read `of` the same values, if it was right; None as `of`: read anew."""
        if of not in self._ready:
            part = read()
            if part is None or of is None:
                return part
            self._ready[of] = self._shared(part)
        return self._ready[of]

    def _shared(self, part: _P) -> _P:
        """A part that is the same for all points that state the same: of 100 000 points, few are different."""
        stated, parts = self._stated(part)
        try:
            return parts.setdefault(part.sharing(stated), part)  # pyright: ignore[reportReturnType]
        except TypeError:  # one of another package, that has no hash
            return part

    def _stated(self, part: Model) -> tuple[set[str], dict[Model, Model]]:
        stated = part.model_fields_set
        return self._parts.setdefault(frozenset(stated), (stated, {}))

    def _chosen(
        self, scene: Scene, fill: Fill, stated: Mapping[str, Any], numerics: Numerics
    ) -> tuple[Choice | None, OutOfRange | None]:
        """Numerics for the requested error, keeping those that the study states; or why there are none."""
        settings = self._settings
        if settings is None or settings.accuracy.flow_rate is None:
            return None, None
        soft = "stiffness_scale" not in stated and set(settings.measure) <= _SOFTENED
        dt, usual = (numerics.dt, None) if "dt" in stated else (None, numerics.dt)
        kept: dict[str, Any] = {"dt": dt, "stiffness_scale": None if soft else numerics.stiffness_scale}
        kept["precision"] = numerics.precision if "precision" in stated else None
        closed = scene.close(fill.friction, fill.contact)
        try:
            asked, own = settings.accuracy.flow_rate, self._calibration
            return choose(scene, closed, asked, **kept, usual=usual, calibration=own), None
        except OutOfRange as reason:
            return None, reason

    def _grains(self, raw: Mapping[str, Any], found: list[Complaint]) -> Grains | None:
        """The grains come first: their diameter is the unit d of everything else."""
        if "grains" not in raw:
            remedy = "add `grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 3000}`"
            found.append(Complaint(("grains",), "this key is missing", remedy))
            return None
        try:
            return _GRAINS.validate_python(raw["grains"], context={"units": "required"})
        except ValidationError as error:
            found += complaints(error, raw["grains"], ("grains",))
            return None

    def _scene(
        self,
        raw: Mapping[str, Any],
        of: Mapping[str, tuple[Value, ...]],
        grains: Grains | None,
        context: Mapping[str, Any],
        found: list[Complaint],
    ) -> tuple[Scene | None, Scene | None]:
        """The scene, and the nearest thing to it if it is wrong: itself without the values that are."""
        stated = {key: raw[key] for key in SCENE_KEYS if key in raw}
        stated["grains"] = grains or _PLACEHOLDER
        if grains is not None:
            parts = {key: (key, of.get(key), grains.diameter) for key in _PARTS if key in raw}
            ready = {key: self._ready[part] for key, part in parts.items() if part in self._ready}
            scene = _validated(Scene, {**stated, **ready}, context, (), [])
            if scene is not None:
                for key in parts.keys() - ready.keys():
                    self._ready[parts[key]] = self._shared(getattr(scene, key))
                return scene.sharing(self._stated(scene)[0]), scene
        first: list[Complaint] = []
        scene = _validated(Scene, stated, context, (), first)
        if scene is not None:
            return scene, scene
        # Clashes are only looked at once each value is right by itself: look without those that are not, and with
        # misspelled keys put right.
        for complaint in first:
            stated = _moved(stated, complaint.location, complaint.meant)
        again: list[Complaint] = []
        near = _validated(Scene, stated, context, (), again)
        told = {complaint.location for complaint in first}
        found += [*first, *(complaint for complaint in again if complaint.clash and complaint.location not in told)]
        return None, near

    def _numerics(
        self,
        usual: Mapping[str, Any],
        raw: Any,
        scene: Scene | None,
        closed: Scene | None,
        context: Mapping[str, Any],
        found: list[Complaint],
        section: Location,
    ) -> Numerics | None:
        """Numerics as the section `section` states them in `raw`, and `usual` where it does not."""
        settings = {key: value for key, value in raw.items() if key != "dt"} if isinstance(raw, dict) else raw
        if isinstance(settings, dict):
            settings["dt"] = "1 us"  # resolved below, in its scene
        if _validated(Numerics, settings, context, section, found) is None or scene is None:
            return None
        stated = {**usual, **raw}
        try:
            return numerics_for(stated, scene, closed)
        except TimeStepError as error:
            said = f"{shown(stated['dt'])}: " if "dt" in stated else ""
            found.append(Complaint((*section, "dt"), f"{said}{error}", error.remedy, error.clash))
            return None

    def _filled(
        self,
        fill: Fill,
        raw: Any,
        general: Mapping[str, Any],
        numerics: Numerics,
        near: Scene | None,
        closed: Scene | None,
        context: Mapping[str, Any],
        found: list[Complaint],
    ) -> Fill:
        """The filling with the numerics that it states in `raw`, and those of the flow where it does not."""
        own = self._numerics(general, raw, closed or near, None, context, found, _FILLING)
        if own is not None and own.stiffness_scale < numerics.stiffness_scale:
            reason = f"grains {numerics.stiffness_scale / own.stiffness_scale:.3g} times softer than in the discharge"
            remedy = f"use {numerics.stiffness_scale:g} or more: a softer bed would fly apart when it is stiffened"
            found.append(Complaint((*_FILLING, "stiffness_scale"), reason, remedy, clash=True))
        if own is not None and near is not None:
            own = _guarded(own, {**general, **raw}, near)
        return fill.model_copy(update={"numerics": own})

    def _problem(self, complaint: Complaint, assignment: Assignment) -> Problem:
        key = dotted(complaint.location)
        swept = next((one for one in assignment if one == key or one.startswith(f"{key}.")), None)
        line = assignment[swept].line if swept else self._source.line(complaint.location)
        return Problem(self._source.path, line, shown(key), complaint.message, complaint.remedy)


def _validated(
    model: type[Any], raw: Any, context: Mapping[str, Any], section: Location, found: list[Complaint]
) -> Any:
    """`raw`, of the section `section` (none: the whole study), as a `model`; None and complaints if it is none."""
    try:
        return model.model_validate(raw, context=dict(context))
    except ValidationError as error:
        found += complaints(error, raw, section)
        return None


def _guarded(numerics: Numerics, stated: Mapping[str, Any], scene: Scene) -> Numerics:
    """Numerics with the limit of speeds that a scene has, unless one is stated."""
    if "speed_limit" in stated or scene.gravity == 0:
        return numerics
    return numerics.model_copy(update={"speed_limit": speed_limit(scene)})


@once(256)
def _json(part: BaseModel) -> str:
    return part.model_dump_json()


def _apart(data: Any, key: str) -> tuple[Any, Any]:
    """`data` without `key`, and what is there; None if nothing is."""
    if not isinstance(data, dict) or key not in data:
        return data, None
    return {name: value for name, value in data.items() if name != key}, data[key]


def _moved(data: Any, location: Location, target: Location | None) -> Any:
    """`data` without what is at `location`: gone, or under the name that ends `target`. `data` is not changed."""
    if not location or not isinstance(data, dict) or location[0] not in data:
        return data
    head, *rest = location
    if rest:
        return {**data, head: _moved(data[head], tuple(rest), target)}
    others = {key: value for key, value in data.items() if key != head}
    return {str(target[-1]): data[head], **others} if target else others


def _assign(data: Mapping[str, Any], assignment: Assignment) -> dict[str, Any]:
    """The study's data with the point's values put in; sections on the way are copied, never changed."""
    result = dict(data)
    for key, value in assignment.items():
        *sections, leaf = key.split(".")
        inner: Any = result
        for section in sections:
            below = inner.get(section, {})
            if not isinstance(below, dict):
                break  # not a mapping: reported where it stands
            inner[section] = dict(below)
            inner = inner[section]
        else:
            inner[leaf] = value.raw
    return result


class _Keys:
    """The keys that some points sweep: how they are called in labels, and by section."""

    def __init__(self, keys: tuple[str, ...]):
        self._short = _short_names(keys)
        heads = [key.partition(".")[0] for key in keys]
        self._sections = {head: [key for key, one in zip(keys, heads, strict=True) if one == head] for head in heads}
        self._said: dict[Value, str] = {}

    def label(self, assignment: Assignment) -> str:
        """The point in the words of the study; empty for one that sweeps nothing."""
        for key, value in assignment.items():
            if value not in self._said:
                self._said[value] = f"{self._short[key]} {value.said}"
        return ", ".join([self._said[value] for value in assignment.values()])

    def sections(self, assignment: Assignment) -> dict[str, tuple[Value, ...]]:
        """What a point puts into the sections of the study, where it does."""
        return {section: tuple([assignment[key] for key in keys]) for section, keys in self._sections.items()}


def _short_names(keys: Iterable[str]) -> dict[str, str]:
    """`orifice` for container.orifice, unless another key ends alike; what walls and fillings have of their own is
    called by its whole name, since grains have a friction, too."""
    names = list(keys)
    leaves = [name.rpartition(".")[2] for name in names]
    plain = [leaves.count(leaf) == 1 and not name.startswith(_OWN) for name, leaf in zip(names, leaves, strict=True)]
    return {name: leaf if short else name for name, leaf, short in zip(names, leaves, plain, strict=True)}
