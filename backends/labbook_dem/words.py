"""The vocabulary that the physics is written in, as plain Python.

Backends replace it: `func` marks a function to compile, `real` is the scalar of contact laws, `wide` that of positions,
overlaps and updates (`real` may be single, `wide` never is), `vec3` and `wide3` are their vectors, `rounded` turns a
wide number into a real one and `narrow` a vector, `coefs` is the row of a law's coefficients, indexed by names
(`labbook_dem.coefficients`). Literals are written `real(0.5)`, whole numbers may have names in capitals. Functions
choose by conditional expressions and are free of loops, but for `for _ in range(8)`, so that they inline and vectorise.
"""

import math
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass
from typing import TypeVar, cast

F = TypeVar("F", bound=Callable)


def func(function: F) -> F:
    """Mark a function of the physics; in plain Python it is unchanged."""
    return function


def kernel(function: F) -> F:
    """Mark a function of the physics that takes arrays and loops, compiled on its own."""
    return function


def struct(cls: type) -> type:
    """Mark a record of kernels; in plain Python it is unchanged."""
    return cls


real = float
wide = float
coefs = tuple[float, ...]


@dataclass(slots=True)
class vec3:
    """Vector of three reals. It is never changed; a frozen class would take twice as long to create."""

    x: float
    y: float
    z: float

    def __add__(self, other: "vec3") -> "vec3":
        return vec3(self.x + other.x, self.y + other.y, self.z + other.z)

    def __sub__(self, other: "vec3") -> "vec3":
        return vec3(self.x - other.x, self.y - other.y, self.z - other.z)

    def __mul__(self, factor: float) -> "vec3":
        return vec3(self.x * factor, self.y * factor, self.z * factor)

    def __getitem__(self, axis: int) -> float:
        return (self.x, self.y, self.z)[axis]

    def __neg__(self) -> "vec3":
        return vec3(-self.x, -self.y, -self.z)


wide3 = vec3
section = vec3
"""Wide vector without y, of which walls store x and z (`labbook_dem.walls`)."""


def narrow(vector: wide3) -> vec3:
    """Wide vector as a real one."""
    return vector


def rounded(number: wide) -> real:
    """Wide number as a real one."""
    return number


def dot(a: vec3, b: vec3) -> float:
    """Scalar product."""
    return a.x * b.x + a.y * b.y + a.z * b.z


def cross(a: vec3, b: vec3) -> vec3:
    """Vector product."""
    return vec3(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)


sqrt = math.sqrt
floor = math.floor

# optional features: constants of a generated module, so that compilers leave out unused branches
FRICTION = True
VARIED = True  # spheres differ in size, material or both
PERIODIC = True  # the container repeats along y


class Switch:
    """Feature that is on or off within a context, in plain Python (`labbook_dem.chosen`)."""

    def __init__(self, name: str, on: bool):
        self.on: ContextVar[bool] = ContextVar(name, default=on)

    def __bool__(self) -> bool:
        return self.on.get()


rolling, twist = Switch("rolling", True), Switch("twist", True)
ROLLING = cast(bool, rolling)  # rolling resistance is a torque against the rotation, without a spring
ROLLING_SPRING = True  # it has a spring
TWIST = cast(bool, twist)  # rolling resistance acts on twist too
