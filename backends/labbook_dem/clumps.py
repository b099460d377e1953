"""Clumps: rigid bodies of spheres with three different moments of inertia.

Contacts are those of spheres on levers: the branch from the centre of mass of a clump to the centre of a sphere of it.
Spheres move as parts of their clump (`sphere_velocity`), and their contacts are those of free spheres with the mass of
the clump (`labbook_dem.spheres`). Force and torque then act on the clump (`torque_on_clump`).

The state of the rotation is that of rods (`labbook_dem.rotation`): a unit quaternion q, whose rotation takes the body
frame to space, and the reduced angular momentum m = L/I_y [rad/s] in the frame of the lab, I_y the middle moment. With
`flat` = I_y/I_x - 1 and `slender` = I_y/I_z - 1 the spin is m + flat (m.a_x) a_x + slender (m.a_z) a_z.
"""

from labbook_dem.rotation import turn
from labbook_dem.words import dot, func, sqrt, wide, wide3


@func
def from_body(w: wide, x: wide, y: wide, z: wide, c: wide3):
    """Vector in space that is c in the body frame: c + 2 w (v x c) + 2 v x (v x c), v = (x, y, z)."""
    two = wide(2.0)
    tx = two * (y * c.z - z * c.y)
    ty = two * (z * c.x - x * c.z)
    tz = two * (x * c.y - y * c.x)
    return wide3(
        c.x + w * tx + (y * tz - z * ty), c.y + w * ty + (z * tx - x * tz), c.z + w * tz + (x * ty - y * tx)
    )  # fmt: skip


@func
def first_axis(w: wide, x: wide, y: wide, z: wide):
    """Unit vector along the x axis of the body frame, that of the largest moment of inertia."""
    unity = wide(1.0)
    two = wide(2.0)
    return wide3(unity - two * (y * y + z * z), two * (x * y + w * z), two * (x * z - w * y))


@func
def spin_of_clump(m: wide3, first: wide3, third: wide3, flat: wide, slender: wide):
    """Angular velocity [rad/s] of a clump; first, third: unit vectors along its axes x and z."""
    return m + (first * (flat * dot(m, first)) + third * (slender * dot(m, third)))


@func
def about_first(w: wide, x: wide, y: wide, z: wide, m: wide3, flat: wide, dt: wide):
    """q after a rotation by flat (m.a_x) dt about the x axis of the body frame, which conserves m.a_x.

    The angle t follows from tan(t/2) = (t/2)/(1 - (t/2)^2/3), with an error of t^5/720, as in `labbook_dem.rotation`.
    """
    unity = wide(1.0)
    third = wide(1.0) / wide(3.0)
    g = flat * (wide(0.5) * dt) * dot(m, first_axis(w, x, y, z))
    c = unity - g * g * third
    size = unity / sqrt(c * c + g * g)
    c = c * size
    g = g * size
    return c * w - g * x, c * x + g * w, c * y + g * z, c * z - g * y


@func
def turn_clump(w: wide, x: wide, y: wide, z: wide, m: wide3, flat: wide, slender: wide, dt: wide):
    """q after dt [s] of free motion, to second order in dt: half of the rotation about the x axis of the body frame,
    the exact motion of the symmetric top without it, and the other half.

    The energy |m|^2 + flat (m.a_x)^2 + slender (m.a_z)^2 is split into its parts (Strang), of which each moves the
    clump by a rotation that conserves the angular momentum. So |m| is conserved exactly, and the error of the energy
    does not grow: relative, it is below flat slender (|m| dt)^2. Symmetric tops (flat = 0 or slender = 0) are exact.
    """
    half = wide(0.5) * dt
    w, x, y, z = about_first(w, x, y, z, m, flat, half)
    w, x, y, z = turn(w, x, y, z, m, slender, dt)
    return about_first(w, x, y, z, m, flat, half)


@func
def sphere_velocity(v: wide3, spin: wide3, lever: wide3):
    """Velocity [m/s] of the centre of a sphere of a clump, which moves with v and turns with `spin` [rad/s]."""
    return wide3(
        v.x + (spin.y * lever.z - spin.z * lever.y),
        v.y + (spin.z * lever.x - spin.x * lever.z),
        v.z + (spin.x * lever.y - spin.y * lever.x),
    )


@func
def torque_on_clump(torque: wide3, force: wide3, lever: wide3):
    """Torque [N m] about the centre of mass of a clump, of a force [N] and a torque about the centre of a sphere."""
    return wide3(
        torque.x + (lever.y * force.z - lever.z * force.y),
        torque.y + (lever.z * force.x - lever.x * force.z),
        torque.z + (lever.x * force.y - lever.y * force.x),
    )
