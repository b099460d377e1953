"""One point of a study while it is read: its parts, and what is wrong with them."""

from collections.abc import Mapping
from typing import Any

from pydantic import TypeAdapter, ValidationError

from labbook.backend.numerics import Numerics
from labbook.scene.attached import StudyFolder
from labbook.scene.grains import Grains, Spheres
from labbook.scene.scene import Scene
from labbook.study.explain import Complaint, complaints
from labbook.study.problems import quote
from labbook.study.schema import SCENE_KEYS, Fill
from labbook.study.source import Location
from labbook.study.timestep import TimeStepError, resolve, speed_limit

_NUMERICS, _FILLING = ("numerics",), ("fill", "numerics")
_STEPS = ((*_NUMERICS, "dt"), (*_FILLING, "dt"))
_GRAINS = TypeAdapter(Grains)
_PLACEHOLDER = Spheres(diameter=1e-3, density=1e3, count=1)  # stands in for grains that are wrong


class Draft:
    """One point while it is read, section by section. A part that is wrong is None, and `complaints` say why.

    All sections are read even if one is wrong, so that all problems of a study are found at once. A section that needs
    a wrong one is checked against the nearest thing to it: grains of 1 mm, or the scene without its wrong values.
    """

    def __init__(self, data: Mapping[str, Any], beside: StudyFolder):
        """data: the sections of the study, with the values of the point in them; beside: where its files are."""
        self._complaints: list[Complaint] = []
        self.numerics_keys: Any = data.get("numerics", {})
        """The section `numerics` as it is written."""
        fill, own = _apart(data.get("fill", {}), "numerics")

        self._context: dict[str, Any] = {"units": "required", "beside": beside}
        self._grains = self._read_grains(data)
        grains = self._grains or _PLACEHOLDER
        self._context |= {"d": grains.diameter, "grains": grains}
        self._scene, self._nearest = self._read_scene(data)
        self._fill: Fill | None = self._validated(Fill, fill, ("fill",))
        self._closed = self._read_closed()
        # a step of its own is for the filling alone
        closed = self._closed if own is None else None
        self._numerics = self._read_numerics(self.numerics_keys, {}, self._nearest, closed, _NUMERICS)
        if own is not None and self._fill is not None and self._numerics is not None:
            numerics = self._read_numerics_of_filling(own, self._numerics)
            self._fill = self._fill.model_copy(update={"numerics": numerics})

    @property
    def complaints(self) -> list[Complaint]:
        """Everything that is wrong, in the order of the sections."""
        return [complaint for complaint in self._complaints if self._holds(complaint)]

    @property
    def validated(self) -> tuple[Scene, Fill, Numerics] | None:
        """Scene, filling and numerics; None if anything is wrong."""
        scene, fill, numerics = self._scene, self._fill, self._numerics
        if self._complaints or scene is None or fill is None or numerics is None:
            return None
        return scene, fill, numerics

    def _holds(self, complaint: Complaint) -> bool:
        """True if a complaint holds. A clash with a placeholder may not: the value may suit the intended scene."""
        if not complaint.clash:
            return True
        if self._grains is None:
            return complaint.location[0] == "grains"
        return self._scene is not None or complaint.location not in _STEPS

    def _read_grains(self, data: Mapping[str, Any]) -> Grains | None:
        """The grains come first: their diameter is the unit d of everything else."""
        if "grains" not in data:
            remedy = "add `grains: {shape: sphere, diameter: 3 mm, density: 2500 kg/m^3, count: 3000}`"
            self._complaints.append(Complaint(("grains",), "this key is missing", remedy))
            return None
        try:
            return _GRAINS.validate_python(data["grains"], context=dict(self._context))
        except ValidationError as error:
            self._complaints += complaints(error, data["grains"], ("grains",))
            return None

    def _read_scene(self, data: Mapping[str, Any]) -> tuple[Scene | None, Scene | None]:
        """The scene, and the nearest thing to it: itself without the values that are wrong."""
        scene_keys = {key: data[key] for key in SCENE_KEYS if key in data}
        scene_keys["grains"] = self._grains or _PLACEHOLDER
        scene, first = self._attempt(Scene, scene_keys)
        if scene is not None:
            return (None if self._grains is None else scene), scene
        # Clashes are only looked at once each value is right by itself: look without those that are not, and with
        # misspelled keys put right.
        for complaint in first:
            scene_keys = _moved(scene_keys, complaint.location, complaint.target)
        nearest, second = self._attempt(Scene, scene_keys)
        wrong = {complaint.location for complaint in first}
        clashes = [complaint for complaint in second if complaint.clash and complaint.location not in wrong]
        self._complaints += [*first, *clashes]
        return None, nearest

    def _read_closed(self) -> Scene | None:
        """The scene of the filling, where a law of its own makes other time steps stable in it."""
        scene, fill = self._nearest, self._fill
        if scene is None or fill is None or fill.contact is None:
            return None
        faults = tuple(scene.faults_of_law(fill.contact))
        for fault in faults:
            self._complaints.append(Complaint(("fill", *fault.key.split(".")), fault.reason, fault.remedy))
        return None if faults else scene.close(fill.friction, fill.contact)

    def _read_numerics(
        self,
        keys: Any,
        inherited: Mapping[str, Any],
        scene: Scene | None,
        closed: Scene | None,
        section: Location,
    ) -> Numerics | None:
        """Numerics that `section` states, and `inherited` where it does not, with a time step for `scene` and for
        `closed`, the scene of its filling."""
        if not isinstance(keys, Mapping):
            return self._validated(Numerics, keys, section)
        keys = {**inherited, **keys}
        numerics: Numerics | None = self._validated(Numerics, {**keys, "dt": "1 us"}, section)  # resolved below
        if numerics is None or scene is None:
            return None
        try:
            dt = resolve(keys.get("dt"), scene, numerics.stiffness_scale, closed)
        except TimeStepError as error:
            value = f"{quote(keys['dt'])}: " if "dt" in keys else ""
            self._complaints.append(Complaint((*section, "dt"), f"{value}{error}", error.remedy, error.clash))
            return None
        return numerics.model_copy(update={"dt": dt})

    def _read_numerics_of_filling(self, keys: Any, discharge: Numerics) -> Numerics | None:
        """Numerics that `fill` states, and those of the discharge where it does not."""
        scene = self._closed or self._nearest
        numerics = self._read_numerics(keys, self.numerics_keys, scene, None, _FILLING)
        if numerics is None or self._nearest is None:
            return None
        if numerics.stiffness_scale < discharge.stiffness_scale:
            softer = discharge.stiffness_scale / numerics.stiffness_scale
            reason = f"grains {softer:.3g} times softer than in the discharge"
            remedy = f"use {discharge.stiffness_scale:g} or more: a softer bed would fly apart when it is stiffened"
            self._complaints.append(Complaint((*_FILLING, "stiffness_scale"), reason, remedy, clash=True))
        return guarded(numerics, {**self.numerics_keys, **keys}, self._nearest)

    def _validated(self, model: type[Any], keys: Any, section: Location) -> Any:
        """`stated`, of the section `section`, as a `model`; None and complaints if it is none."""
        instance, wrong = self._attempt(model, keys, section)
        self._complaints += wrong
        return instance

    def _attempt(self, model: type[Any], keys: Any, section: Location = ()) -> tuple[Any, list[Complaint]]:
        try:
            return model.model_validate(keys, context=dict(self._context)), []
        except ValidationError as error:
            return None, list(complaints(error, keys, section))


def guarded(numerics: Numerics, keys: Mapping[str, Any], scene: Scene) -> Numerics:
    """Numerics with the limit of speeds that a scene has, unless one is stated."""
    if "speed_limit" in keys or scene.gravity == 0:
        return numerics
    return numerics.model_copy(update={"speed_limit": speed_limit(scene)})


def _apart(data: Any, key: str) -> tuple[Any, Any]:
    """`data` without `key`, and the value there; None if there is none."""
    if not isinstance(data, dict) or key not in data:
        return data, None
    return {name: value for name, value in data.items() if name != key}, data[key]


def _moved(data: Any, location: Location, target: Location | None) -> Any:
    """`data` without the value at `location`: removed, or under the name that ends `target`. `data` is not changed."""
    if not location or not isinstance(data, dict) or location[0] not in data:
        return data
    head, *rest = location
    if rest:
        return {**data, head: _moved(data[head], tuple(rest), target)}
    siblings = {key: value for key, value in data.items() if key != head}
    return {str(target[-1]): data[head], **siblings} if target else siblings
