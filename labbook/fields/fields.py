"""Fields from grains and contacts by coarse-graining (Goldhirsch, Granul. Matter 12 (2010) 239)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import fields as fields_of
from functools import cached_property

import numpy as np

from labbook.fields.grids import Grid, Layer, Ring, Space, Span
from labbook.fields.kernel import CUTOFF, amplitude
from labbook.fields.rows import ContactRows, GrainRows

_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_SUMS = ("density", "packing_fraction", "momentum", "flux", "number", "axes", "contact_stress")
_PLACE = np.array([[0, 3, 4], [3, 1, 5], [4, 5, 2]])


@dataclass(frozen=True, eq=False)
class Fields:
    """Means over the frames, at the points of `grid`; vectors [3, ...] and tensors [3, 3, ...] have the axes that
    `grid.components` names.

    Sums phi-weighted over grains, per frame: `density` [kg/m^3], `packing_fraction`, `momentum` [kg/m^2/s], `flux`
    (m v v) [Pa], `number` [1/m^3] and, of rods, `axes` (l l) [1/m^3]. `contact_stress` [Pa]: -sum f b int phi along the
    branch, positive in compression; None without contacts. Where no kernel reaches, ratios are NaN.
    """

    grid: Grid
    omega: float
    density: np.ndarray
    packing_fraction: np.ndarray
    momentum: np.ndarray
    flux: np.ndarray
    number: np.ndarray
    axes: np.ndarray | None
    contact_stress: np.ndarray | None

    def arrays(self) -> dict[str, np.ndarray]:
        """The fields as arrays by name, from which `of` makes them again."""
        kind, numbers = type(self.grid).__name__, np.hstack([np.ravel(v) for v in vars(self.grid).values()])
        sums = {name: a for name, a in vars(self).items() if isinstance(a, np.ndarray) and name in _SUMS}
        return {"grid": np.array(kind), "grid_numbers": numbers, "omega": np.array(self.omega), **sums}

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> "Fields":
        """The fields that `arrays` gave. Raises KeyError or ValueError for others."""
        grid = {kind.__name__: kind for kind in (Layer, Space, Ring)}[str(arrays["grid"])]
        numbers, offset, values = arrays["grid_numbers"].tolist(), 0, {}
        for part in fields_of(grid):
            if part.type is Span or part.type == "Span":
                values[part.name], offset = (numbers[offset], numbers[offset + 1]), offset + 2
            else:
                whole = part.type in (int, "int")
                values[part.name], offset = int(numbers[offset]) if whole else numbers[offset], offset + 1
        return cls(grid(**values), float(arrays["omega"]), **{name: arrays.get(name) for name in _SUMS})  # pyright: ignore[reportArgumentType]

    @property
    def mass(self) -> float:
        """Mass within the grid [kg]."""
        return float((self.density * self.grid.volumes).sum())

    @cached_property
    def velocity(self) -> np.ndarray:
        """V = momentum / density [m/s]."""
        return _ratio(self.momentum, self.density)

    @cached_property
    def kinetic_stress(self) -> np.ndarray:
        """sum m v' v' phi [Pa] of the fluctuations v' = v - V(r) about the mean velocity at the point; positive.

        Since sum m v phi = rho V at the same point, it is the flux less rho V V, exactly.
        """
        mean = np.where(self.density > 0, self.velocity, 0.0)
        return self.flux - self.density * mean[:, None] * mean[None, :]

    @property
    def kinetic_pressure(self) -> np.ndarray:
        """p_k = Tr of the kinetic stress [Pa] (Pongo et al. 2022; not a third of it)."""
        return np.trace(self.kinetic_stress)

    @cached_property
    def orientation(self) -> np.ndarray:
        """O = sum l l phi / sum phi, of trace 1. Raises ValueError for grains without axes."""
        if self.axes is None:
            raise ValueError("spheres have no orientation")
        return _ratio(self.axes, self.number)

    @property
    def nematic_order(self) -> np.ndarray:
        """S, the largest eigenvalue of O: 1/3 for directions at random, 1 for rods all parallel."""
        return nematic_order(self.orientation)


def nematic_order(orientation: np.ndarray) -> np.ndarray:
    """Largest eigenvalue of orientation tensors [3, 3, ...]; NaN where they are."""
    moved = np.moveaxis(orientation, (0, 1), (-2, -1))
    finite = np.isfinite(moved).all(axis=(-2, -1))
    largest = np.full(finite.shape, np.nan)
    largest[finite] = np.linalg.eigvalsh(moved[finite])[..., -1]
    return largest


def coarse_grain(
    grid: Grid,
    omega: float,
    grains: GrainRows,
    contacts: ContactRows | None = None,
    *,
    normalised: bool = False,
    threads: int | None = None,
) -> Fields:
    """Fields of `grains` (and stress of `contacts`) with a Gaussian of width `omega` [m], cut off at 4 omega.

    Walls and other boundaries are ignored unless `normalised`. Kernels reach over them: densities and stresses fall off
    within 4 omega of a wall (to a half at it), while velocities, orientations and other ratios do not. Forces of walls
    act at the contact point, and the stress of a wall's contact spreads from there to the centre. With `normalised` the
    kernel of each grain is scaled to sum to 1 over the grid, so that mass is conserved to round-off. The grid should
    then end at the walls. Stresses are never scaled: their divergence balances gravity as they are. Cells should be no
    wider than omega. Raises ImportError without Numba.
    """
    compiled = _compiled()
    used = threads or compiled.threads()
    with compiled.limited(used):
        if isinstance(grid, Ring):
            sums = _about_axis(compiled, grid, omega, grains, normalised, used)
        else:
            sums = _on_lattice(compiled, grid, omega, grains, normalised, used)
        stress = None if contacts is None else _stress(compiled, grid, omega, contacts, used) / contacts.frames
    sums /= grains.frames
    number, axes = sums[0], sums[10:16][_PLACE] if grains.axis is not None else None
    mass = 1.0 if grains.unlike else grains.mass  # else it is in the sums already
    density, fraction = sums[-2:] if grains.unlike else (number * grains.mass, number * grains.volume)
    momentum, flux = sums[1:4] * mass, sums[4:10][_PLACE] * mass
    return Fields(grid, omega, density, fraction, momentum, flux, number, axes, stress)


def _of_grains(
    grains: GrainRows, v: np.ndarray, squares: Sequence[np.ndarray], axes: Sequence[np.ndarray]
) -> np.ndarray:
    """Quantities that are summed over grains, shape [n, F]: number, v and its squares, tensors of rods. For grains that
    differ, v and squares are times the mass, and mass and volume come last."""
    mass = grains.mass if grains.unlike else 1.0
    own = [grains.mass, grains.volume] if grains.unlike else []
    return np.column_stack([np.ones(len(v)), *(v.T * mass), *(one * mass for one in squares), *axes, *own])


def _ratio(top: np.ndarray, bottom: np.ndarray) -> np.ndarray:
    return np.divide(top, bottom, out=np.full(top.shape, np.nan), where=bottom > 0)


def _compiled():
    try:
        from labbook.fields import threaded
    except ImportError as error:
        raise ImportError("fields are computed by Numba; install it with: pip install 'labbook[numba]'") from error
    return threaded


def _lattice(grid: Grid) -> tuple[np.ndarray, np.ndarray, tuple[int, int, int]]:
    """Lower corner [m], step [m] and shape (nz, ny, nx); a layer has a step of 0 along y."""
    if isinstance(grid, Layer):
        low, step = (grid.x[0], 0.0, grid.z[0]), ((grid.x[1] - grid.x[0]) / grid.nx, 0.0)
        return np.array(low), np.array([*step, (grid.z[1] - grid.z[0]) / grid.nz]), (grid.nz, 1, grid.nx)
    assert not isinstance(grid, Ring)
    spans, counts = (grid.x, grid.y, grid.z), (grid.nx, grid.ny, grid.nz)
    step = [(high - low) / n for (low, high), n in zip(spans, counts, strict=True)]
    return np.array([low for low, _ in spans]), np.array(step), (grid.nz, grid.ny, grid.nx)


def _scale(grid: Grid, omega: float) -> float:
    """Amplitude of the kernel; that of a layer's disc is spread over its depth."""
    return amplitude(omega, grid.dimensions) / (grid.depth if isinstance(grid, Layer) else 1.0)


def _on_lattice(compiled, grid: Grid, omega: float, grains: GrainRows, normalised: bool, threads: int) -> np.ndarray:
    low, step, shape = _lattice(grid)
    squares, axes = (
        [] if one is None else [one[:, i] * one[:, j] for i, j in _PAIRS] for one in (grains.v, grains.axis)
    )
    values = _of_grains(grains, grains.v, squares, axes)
    out = np.zeros((threads, values.shape[1], *shape))
    scale = 1 / float(grid.volumes.flat[0]) if normalised else _scale(grid, omega)
    order = _by_place(grains.x[:, 0], grains.x[:, 2], omega)
    table, x = values[order], grains.x[order]
    compiled.on_lattice(x, table, low, step, omega, CUTOFF * omega, scale, normalised, out)
    return out.sum(axis=0).reshape(-1, *grid.shape)


def _by_place(a: np.ndarray, b: np.ndarray, omega: float) -> np.ndarray:
    """An order in which grains that follow each other lie near each other, so that caches hold what they write to."""
    return np.lexsort((b, a // omega))


def _about_axis(compiled, grid: Ring, omega: float, grains: GrainRows, normalised: bool, threads: int) -> np.ndarray:
    rho, v = _cylindrical(grains.x, grains.v)
    axes = [] if grains.axis is None else _harmonics(_cylindrical(grains.x, grains.axis)[1])
    tensors = 1 if grains.axis is None else 2
    orders = [0, *_VECTOR, *(_TENSOR * tensors), *([0, 0] if grains.unlike else [])]
    by_place = _by_place(rho, grains.x[:, 2], omega)
    values = _of_grains(grains, v, _harmonics(v), axes)[by_place]
    out = np.zeros((threads, values.shape[1], *grid.shape))
    scale = 1.0 if normalised else _scale(grid, omega)
    vertical = (grid.z[0], (grid.z[1] - grid.z[0]) / grid.nz)
    position, width, kinds = (rho[by_place], grains.x[by_place, 2]), grid.radius / grid.nr, np.array(orders)
    compiled.about_axis(*position, values, kinds, width, vertical, omega, CUTOFF * omega, scale, normalised, out)
    sums = out.sum(axis=0)
    for first in range(4, 4 + 6 * tensors, 6):  # rr and tt from their sum and difference
        both, difference = sums[first].copy(), sums[first + 1].copy()
        sums[first], sums[first + 1] = (both + difference) / 2, (both - difference) / 2
    return sums


def _cylindrical(x: np.ndarray, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance from the axis, and vectors in the cylindrical axes there (those of azimuth 0 on the axis itself)."""
    rho = np.hypot(x[:, 0], x[:, 1])
    cos, sin = np.divide(x[:, :2].T, rho, out=np.array([np.ones(len(x)), np.zeros(len(x))]), where=rho > 0)
    radial = cos * vectors[:, 0] + sin * vectors[:, 1]
    around = cos * vectors[:, 1] - sin * vectors[:, 0]
    return rho, np.column_stack([radial, around, vectors[:, 2]])


# At a point that lies at the azimuth d from a grain its radial and azimuthal components are turned by d. In the mean
# over d, in which the kernel is even, a vector keeps cos d of them, the sum rr + tt of a tensor is as it was, and
# rr - tt and rt keep cos 2d. These are the multiples of d:
_VECTOR, _TENSOR = [1, 1, 0], [0, 2, 0, 2, 1, 1]


def _harmonics(v: np.ndarray) -> list[np.ndarray]:
    """rr + tt, rr - tt, zz, rt, rz, tz of v v."""
    r, t, z = v.T
    return [r * r + t * t, r * r - t * t, z * z, r * t, r * z, t * z]


def _stress(compiled, grid: Grid, omega: float, contacts: ContactRows, threads: int) -> np.ndarray:
    x, b = contacts.x, contacts.branch
    scale, reach = _scale(grid, omega), CUTOFF * omega
    if isinstance(grid, Ring):
        middle = x + b / 2
        force, line, start = (_cylindrical(middle, a)[1] for a in (contacts.force, b, x))
        tensors = np.ascontiguousarray(-force[:, :, None] * line[:, None, :])
        out = np.zeros((threads, 9, *grid.shape))
        vertical = (grid.z[0], (grid.z[1] - grid.z[0]) / grid.nz)
        compiled.lines_about_axis(start, line, tensors, grid.radius / grid.nr, vertical, omega, reach, scale, out)
    else:
        low, step, shape = _lattice(grid)
        tensors = np.ascontiguousarray((-contacts.force[:, :, None] * b[:, None, :]).reshape(-1, 9))
        out = np.zeros((threads, 9, *shape))
        compiled.lines_on_lattice(
            np.ascontiguousarray(x), np.ascontiguousarray(b), tensors, low, step, omega, reach, scale, out
        )
    return out.sum(axis=0).reshape(3, 3, *grid.shape)
