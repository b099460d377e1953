"""Wall stress of a point: means over beds, and Janssen's law fitted to them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from labbook.fit import FitError
from labbook.fit.janssen import BulkFit, BulkProfile, JanssenFit, WallProfile, fit_bulk, fit_janssen, preferred
from labbook.measure.bulk_stress import BulkStress, SectionForces
from labbook.measure.wall_stress import FILTER, FILTERS, WallStress, WallStresses
from labbook.results.paper import Row
from labbook.results.points import PointResult
from labbook.scene.timescales import gravity_time

_TOP = 0.1
"""Part of the weight, from the top of the bed, in which both sources of the vertical stress are not compared."""
_FEWEST_BEDS = 3
"""Beds from which on a jackknife gives an error."""


@dataclass(frozen=True, eq=False)
class VerticalStress:
    """Mean vertical stress later, by height, from two sources: over beds, shape [beds, k].

    Attributes:
        z: Heights [m], the middles of bins of upright walls, shape [k].
        walls: By the weight of the bed above and the shear of upright walls [Pa].
        field: By the coarse-grained stress of the contacts in the bed [Pa].
        fits: Models of Janssen's law fitted to `field`, by name; in closed containers only.
    """

    z: np.ndarray
    walls: np.ndarray
    field: np.ndarray
    fits: Mapping[str, BulkFit]

    @property
    def ratio(self) -> tuple[float, float]:
        """Mean stress of the field over that by the walls, and its standard error between beds; NaN of one bed."""
        ratios = self.field.mean(axis=1) / self.walls.mean(axis=1)
        return float(ratios.mean()), float(_error(ratios))

    @property
    def largest(self) -> float:
        """Largest difference of both means over beds at one height, relative to the mean stress by the walls."""
        walls = self.walls.mean(axis=0)
        return float(np.abs(self.field.mean(axis=0) - walls).max() / walls.mean())


@dataclass(frozen=True, eq=False)
class PooledWalls:
    """Wall stress of a point; `beds`: of each bed, the stresses of its discharges. `sections`: of the same runs the
    forces through sections of the bed, None where `bulk_stress` was not measured."""

    result: PointResult
    beds: tuple[tuple[WallStresses, ...], ...]
    sections: tuple[tuple[SectionForces | None, ...], ...] = ()

    @property
    def layout(self) -> WallStresses:
        """The first run, for walls, bins and areas, which all runs of a point have in common."""
        return self.beds[0][0]

    def by_bed(self, name: str) -> np.ndarray:
        """An attribute of `WallStresses`, the mean over the discharges of each bed, shape [beds, ...]."""
        return np.array([np.mean([getattr(run, name) for run in bed], axis=0) for bed in self.beds])

    def pooled(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Mean over the beds that have an attribute, and its standard error; NaN of one bed."""
        values = self.by_bed(name)
        finite = np.isfinite(values.reshape(len(values), -1)).any(axis=1)
        values = values[finite] if finite.any() else values
        return values.mean(axis=0), _error(values)

    def opening(self) -> tuple[np.ndarray, np.ndarray]:
        """Normal force on upright walls after the opening, relative to that at rest.

        Returns:
            Times after the opening [s], shape [n], up to the end of the shortest run, and moving means of the force
            ratio of each bed, shape [beds, n].
        """
        rows = []
        for bed in self.beds:
            runs = [run.opening[:, run.on_upright].sum(axis=1) / run.rest[run.on_upright, 0].sum() for run in bed]
            shortest = min(map(len, runs))
            rows.append(np.mean([row[:shortest] for row in runs], axis=0))
        shortest = min(map(len, rows))
        return self.layout.opening_time[:shortest], np.array([row[:shortest] for row in rows])

    def rows(self) -> Iterator[Row]:
        """A row for each bin: stresses [Pa] at rest and later, with their errors over beds, and contacts."""
        layout = self.layout
        columns: dict[str, np.ndarray] = {}
        for when, area in (("rest", layout.rest_area), ("flow", layout.area)):
            mean, error = (value / area[:, None] for value in self.pooled(when))
            for index, name in enumerate(("normal", "shear", "across")):
                columns[f"{name}_{when}"], columns[f"{name}_{when}_error"] = mean[:, index], error[:, index]
            for name in ("contacts", "sliding"):
                columns[f"{name}_{when}"], _ = self.pooled(f"{when}_{name}")
        for k, number in enumerate(layout.wall):
            index = {"wall": str(layout.names[number]), "along": str(layout.coordinates[number])}
            ends = {"from": float(layout.low[k]), "to": float(layout.high[k])}
            yield {**index, **ends, **{name: float(values[k]) for name, values in columns.items()}}

    def peak_rows(self) -> Iterator[Row]:
        """A row for each time of the moving mean [s]: peak of the normal force on upright walls after the opening over
        that at rest, the mean of the peaks of beds with its error, and, for the time FILTER, the peak of their mean."""
        unit, (_, opening) = gravity_time(self.result.point.scene), self.opening()
        mean, error = self.pooled("peaks")
        of_mean = float(opening.mean(axis=0).max()) if opening.size else math.nan
        for index, tau in enumerate(FILTERS):
            if math.isfinite(mean[index]):
                peak = of_mean if tau == FILTER else math.nan
                numbers = {"peak": float(mean[index]), "error": float(error[index]), "peak_of_mean": peak}
                yield {"filter_time": tau * unit, **numbers, "beds": len(self.beds)}

    @cached_property
    def fits(self) -> Mapping[str, Mapping[str, JanssenFit]]:
        """Models of Janssen's law by name, of the bed `rest` and, in closed containers, of the later part of the run,
        `flow`: walls that move mobilise their friction there. Raises FitError, with the reason, for the bed at rest."""
        every = range(len(self.beds))
        closed = self.result.point.scene.container.outlet_plane is None
        fits: dict[str, Mapping[str, JanssenFit]] = {}
        for when in ("rest", "flow") if closed else ("rest",):
            try:
                fits[when] = fit_janssen(self.profile(every, when))
            except FitError:
                if when == "rest" and not closed:
                    raise
        if not fits:
            self.profile(every)
        return fits

    def preferred(self, when: str = "rest") -> tuple[str, ...]:
        """Models that no other beats."""
        return preferred(self.fits[when])

    def error_between_beds(self, when: str, model: str, parameter: str) -> float:
        """Standard error of a parameter by the jackknife over beds; NaN of fewer than three."""
        values = [fits[model].parameters[parameter].value for fits in self._without_one(when) if model in fits]
        count = len(self.beds)
        return float(math.sqrt((count - 1) * np.var(values))) if len(values) == count else math.nan

    @cached_property
    def vertical(self) -> VerticalStress | None:
        """Vertical stress from walls and from the field of the contacts; None where `bulk_stress` was not measured, or
        where no bin of upright walls is between the foot and the top tenth of the weight."""
        layout = self.layout
        pairs = [
            [(run, forces) for run, forces in zip(bed, own, strict=True) if forces and np.isfinite(run.flow).all()]
            for bed, own in zip(self.beds, self.sections, strict=False)
        ]
        pairs = [bed for bed in pairs if bed]
        bins = np.flatnonzero(layout.in_use(self.result.point.scene.grains.equivalent_diameter))
        used = np.zeros(len(layout.wall), bool)
        used[bins[np.unique(layout.low[bins], return_index=True)[1]]] = True  # walls may share heights
        if not pairs:
            return None
        walls, field = [], []
        for bed in pairs:
            both = [(forces.at(layout.middle), run) for run, forces in bed]
            used &= np.all([above > _TOP * above.max() for (_, above), _ in both], axis=0)
            walls.append(np.mean([run.hanging(run.flow, above) for (_, above), run in both], axis=0))
            field.append(np.mean([force / run.section for (force, _), run in both], axis=0))
        if not used.any():
            return None
        z = layout.middle[used]
        walls, field = (np.array(rows)[:, used] for rows in (walls, field))
        return VerticalStress(z, walls, field, self._bulk_fits(z, field.mean(axis=0)))

    def _bulk_fits(self, z: np.ndarray, stress: np.ndarray) -> Mapping[str, BulkFit]:
        """Models fitted to the mean vertical stress in a closed container; none of other beds, whose surface sinks, or
        of too few heights."""
        if self.result.point.scene.container.outlet_plane is not None:
            return {}
        surface, density = (float(self.by_bed(name).mean()) for name in ("surface", "density"))
        error = np.full(len(z), float(stress.mean()))
        try:
            return fit_bulk(BulkProfile(surface - z[::-1], stress[::-1], error, density * self.layout.gravity))
        except FitError:
            return {}

    def vertical_rows(self) -> Iterator[Row]:
        """A row for each height [m] with the mean vertical stress [Pa] from both sources, and errors over beds."""
        stress = self.vertical
        if stress is None:
            return
        columns = {name: (rows.mean(axis=0), _error(rows)) for name, rows in
                   (("walls", stress.walls), ("field", stress.field))}  # fmt: skip
        for k, z in enumerate(stress.z.tolist()):
            numbers = {f"{name}{end}": float(values[index][k]) for name, values in columns.items()
                       for index, end in enumerate(("", "_error"))}  # fmt: skip
            yield {"z": z, **numbers, "beds": len(stress.walls)}

    def _without_one(self, when: str) -> list[dict[str, JanssenFit]]:
        """Fits without each of the beds."""
        count = len(self.beds)
        if count < _FEWEST_BEDS:
            return []
        if when not in self._jackknife:
            self._jackknife[when] = [
                fit_janssen(self.profile([k for k in range(count) if k != left_out], when)) for left_out in range(count)
            ]
        return self._jackknife[when]

    @cached_property
    def _jackknife(self) -> dict[str, list[dict[str, JanssenFit]]]:
        """Fits without one seed each, by state of the bed: filled by `_without_one` when first needed."""
        return {}

    def profile(self, beds: Sequence[int], when: str = "rest") -> WallProfile:
        """Mean stresses on upright walls by depth over some of the beds, at `rest` or later, in `flow`.

        Upright walls with the same bins are taken together. Errors are those of sums of independent, exponentially
        distributed contact forces. Raises FitError, with the reason.
        """
        layout, d = self.layout, self.result.point.scene.grains.equivalent_diameter
        numbers = list(beds)
        force, contacts, surface, density = (
            self.by_bed(name)[numbers].mean(axis=0) for name in (when, f"{when}_contacts", "surface", "density")
        )
        if not layout.perimeter > 0:
            raise FitError("Janssen: no upright wall has friction, so that the bottom carries all weight")
        if not (math.isfinite(surface) and math.isfinite(layout.section)):
            raise FitError("Janssen: the bed is too low, or the section of the container is not known; use more grains")
        used = layout.on_upright & (layout.low >= layout.lowest) & (layout.high <= surface - d) & (force[:, 0] > 0)
        if not used.any():
            raise FitError("Janssen: the bed is too low: no bin lies in the part that is compared; use more grains")
        if force[used, 1].sum() <= 0:
            raise FitError(
                "Janssen: the upright walls carry no weight, as after a fall of the grains in a narrow column; "
                "mobilise their friction by fill.mobilise"
            )
        area = layout.rest_area
        starts = sorted(set(layout.low[used].tolist()), key=lambda low: area[used & (layout.low == low)].sum())
        size = float(layout.high[used][0] - layout.low[used][0])
        rungs = np.round((layout.low - starts[-1]) / size)
        used &= np.isclose(layout.low, starts[-1] + rungs * size, atol=1e-6 * size)
        rows = []
        for rung in np.unique(rungs[used])[::-1]:
            mine = used & (rungs == rung)
            middle = starts[-1] + (rung + 0.5) * size
            covered, count = area[mine].sum(), max(1.0, len(numbers) * contacts[mine].sum())
            normal, shear = force[mine, 0].sum() / covered, force[mine, 1].sum() / covered
            rows.append((surface - middle, normal, shear, 1 / math.sqrt(count)))
        depth, normal, shear, relative = np.array(rows).T
        mobilised = max(abs(shear.sum() / normal.sum()), 0.05)
        return WallProfile(
            depth=depth,
            normal=normal,
            shear=shear,
            normal_error=normal * relative,
            shear_error=mobilised * normal * relative,
            specific_weight=float(density * layout.gravity),
            section=layout.section / layout.perimeter,
        )


def pooled_walls(result: PointResult) -> PooledWalls | None:
    """Wall stress of a point, where it was measured."""
    beds: dict[int, list[WallStresses]] = {}
    sections: dict[int, list[SectionForces | None]] = {}
    for run in result.runs:
        if not run.counted or WallStress.name not in run.measures:
            continue
        stresses = WallStresses.of(run.evaluation(WallStress()))
        if stresses is not None:
            beds.setdefault(run.seed, []).append(stresses)
            measured = BulkStress.name in run.measures
            forces = SectionForces.of(run.evaluation(BulkStress())) if measured else None
            sections.setdefault(run.seed, []).append(forces)
    return PooledWalls(result, tuple(map(tuple, beds.values())), tuple(map(tuple, sections.values()))) if beds else None


def _error(values: np.ndarray) -> np.ndarray:
    if len(values) < 2:
        return np.full(values.shape[1:], math.nan)
    return values.std(axis=0, ddof=1) / math.sqrt(len(values))
