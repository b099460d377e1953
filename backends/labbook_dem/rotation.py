"""Rotation of rods: symmetric tops, kicked by torques and freely drifting in between.

The state is a unit quaternion q = (w, x, y, z), whose rotation takes the z axis to the rod's axis a, and the reduced
angular momentum m = L / I_t [rad/s] in the frame of the lab, I_t across and I_a about the axis. With `slender` =
I_t/I_a - 1 the spin is omega = m + slender (m.a) a; for a sphere m is omega. A torque T kicks m by T/I_t dt, whatever
the orientation, as it kicks a sphere's spin (`labbook_dem.motion`).
"""

import numpy as np

from labbook.scene import Grains
from labbook.scene.orientation import axes, rotated
from labbook_dem.words import dot, func, real, sqrt, vec3, wide, wide3


@func
def axis(w: wide, x: wide, y: wide, z: wide):
    """Unit vector along the rod."""
    unity = wide(1.0)
    two = wide(2.0)
    return wide3(two * (x * z + w * y), two * (y * z - w * x), unity - two * (x * x + y * y))


@func
def spin(m: vec3, a: vec3, slender: real):
    """Angular velocity [rad/s] of a rod along the unit vector a."""
    return m + a * (slender * dot(m, a))


@func
def turn(w: wide, x: wide, y: wide, z: wide, m: wide3, slender: wide, dt: wide):
    """q after dt [s] of free motion: rotation about m by |m| dt, and about the rod's own axis by slender (m.a) dt.

    This is the exact motion of a free symmetric top (Landau & Lifshitz, Mechanics, section 33) for any angle of
    rotation, so m.a, and with it the energy, is conserved. Angles follow from tan(t/2) = (t/2)/(1 - (t/2)^2/3), with an
    error of t^5/720.
    """
    unity = wide(1.0)
    third = wide(1.0) / wide(3.0)
    half = wide(0.5) * dt
    bx = m.x * half
    by = m.y * half
    bz = m.z * half
    g = slender * half * dot(m, axis(w, x, y, z))
    b = unity - (bx * bx + by * by + bz * bz) * third
    # about m, in the frame of the lab
    w1 = b * w - bx * x - by * y - bz * z
    x1 = b * x + bx * w + by * z - bz * y
    y1 = b * y - bx * z + by * w + bz * x
    z1 = b * z + bx * y - by * x + bz * w
    # about the z axis, in the frame of the rod
    c = unity - g * g * third
    w = c * w1 - g * z1
    x = c * x1 + g * y1
    y = c * y1 - g * x1
    z = c * z1 + g * w1
    # normalised at every step: rounding would let |q| drift
    size = unity / sqrt(w * w + x * x + y * y + z * z)
    return w * size, x * size, y * size, z * size


def slenderness(grains: Grains) -> float:
    """I_t/I_a - 1: 0 for a sphere. Of a clump, the middle moment over the smallest one, less 1."""
    return grains.inertia / grains.inertia_axis - 1


def flatness(grains: Grains) -> float:
    """Middle moment over the largest one, less 1: 0 for spheres and rods (`labbook_dem.clumps`)."""
    return grains.inertia / grains.largest_inertia - 1


def spins(grains: Grains, m: np.ndarray, q: np.ndarray | None) -> np.ndarray:
    """Angular velocities [rad/s] from reduced angular momenta m [n, 3] and orientations q [n, 4]; m if q is None."""
    return _scaled(m, q, flatness(grains), slenderness(grains))


def _scaled(vectors: np.ndarray, q: np.ndarray | None, flat: float, slender: float) -> np.ndarray:
    """Vectors [n, 3] plus `flat` times their component along the x axis of the body, `slender` times that along z."""
    if q is None:
        return vectors
    a = axes(q)
    scaled = vectors + slender * np.sum(vectors * a, axis=1)[:, None] * a
    if flat == 0:
        return scaled
    first = rotated(q, (1.0, 0.0, 0.0))
    return scaled + flat * np.sum(vectors * first, axis=1)[:, None] * first


def momenta(grains: Grains, omega: np.ndarray, q: np.ndarray | None) -> np.ndarray:
    """Reduced angular momenta [rad/s] from angular velocities omega [n, 3] and orientations q [n, 4]; omega if q is
    None."""
    return _scaled(omega, q, grains.largest_inertia / grains.inertia - 1, grains.inertia_axis / grains.inertia - 1)
