"""Size and mass of each grain of a packing."""

import math
from dataclasses import dataclass

import numpy as np

from labbook.scene.grains import Grains, Spheres
from labbook.scene.packing import Packing


@dataclass(frozen=True, eq=False)
class Bodies:
    """Radius [m], mass [kg], moment of inertia [kg m^2] and kind of each grain, arrays of shape [n].

    inertia: of rods about an axis across them, of clumps the middle principal moment. kind: place in `grains.kinds`.
    """

    radius: np.ndarray
    mass: np.ndarray
    inertia: np.ndarray
    kind: np.ndarray

    @classmethod
    def of(cls, grains: Grains, packing: Packing) -> "Bodies":
        """Take radius, mass and kind of each grain from a packing.

        Args:
            grains: Grains of the scene.
            packing: Packing of n of them.

        Returns:
            Bodies in the order of the packing.

        Raises:
            ValueError: The packing has no kinds although the scene does, or kinds or diameters beyond the scene's.
        """
        n, kinds = len(packing), len(grains.species)
        if not grains.varied:
            radius, mass, inertia = (np.full(n, a) for a in (grains.radius, grains.mass, grains.inertia))
            return cls(radius, mass, inertia, np.zeros(n, np.int64))
        kind = np.zeros(n, np.int64) if packing.kind is None else packing.kind
        if packing.kind is None and kinds > 1:
            raise ValueError(f"packing: it has no kinds of grains, and the scene has {kinds}; fill it again")
        if len(kind) and not (kind.min() >= 0 and kind.max() < kinds):
            raise ValueError(f"packing: kinds of grains are not from 0 to {kinds - 1}; fill it again")
        diameter = np.full(n, grains.diameter) if packing.diameter is None else packing.diameter
        if len(diameter) and not (diameter.min() > 0 and diameter.max() <= grains.diameter):
            raise ValueError(f"packing: diameters are not above 0 and up to d = {grains.diameter:g} m; fill it again")
        return cls.sized(grains, diameter, kind)

    @classmethod
    def sized(cls, grains: Grains, diameter: np.ndarray, kind: np.ndarray) -> "Bodies":
        """Make spheres of given sizes.

        Args:
            grains: Grains of the scene, for the densities of their kinds.
            diameter: Diameters [m], shape [n].
            kind: Places in `grains.kinds`, shape [n].

        Returns:
            The spheres, with the moment of inertia (2/5) m r^2.
        """
        mass = np.array([species.density for species in grains.species])[kind] * math.pi / 6 * diameter**3
        return cls(diameter / 2, mass, 0.4 * mass * (diameter / 2) ** 2, kind)

    def carried(self, grains: Grains) -> dict[str, np.ndarray | None]:
        """Select the arrays that a packing of these grains stores.

        Args:
            grains: Grains of the scene.

        Returns:
            `diameter` [m] and `kind`, each of shape [n], or None where all grains are equal in it.
        """
        return {
            "diameter": 2 * self.radius if isinstance(grains, Spheres) and grains.graded else None,
            "kind": self.kind if grains.kinds else None,
        }


def masses(grains: Grains, packing: Packing) -> float | np.ndarray:
    """Compute the mass [kg] of every grain where they are equal, else of each, shape [n]."""
    return Bodies.of(grains, packing).mass if grains.varied else grains.mass


def kind_names(grains: Grains) -> np.ndarray:
    """Names of the kinds of grains, in the order in which `Bodies.kind` counts them; empty without kinds."""
    return np.array([kind.name for kind in grains.kinds], dtype=str)
