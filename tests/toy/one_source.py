"""The physics in plain Python, and what it takes to compare it with what compilers make of it."""

import ast
import importlib
import importlib.util
import inspect
import pkgutil
from types import ModuleType

import labbook_dem
import numpy as np
from labbook_dem import clumps, contact, rods, rotation, source, spheres, words
from labbook_dem.chosen import choose
from labbook_dem.laws import hertz_lammps, hertz_liggghts, hertz_mindlin, hertz_printed, linear

from labbook.scene import HertzLammps, HertzLiggghts, HertzMindlin, HertzPrinted, LinearSpringDashpot, Surface

COUNT = 400
LAW = "hertz-mindlin"
"""Of contacts of spheres, rods and clumps."""
SURFACE = Surface(friction=0.5, rolling_friction=0.01, restitution=0.2)
COEFFICIENTS = {
    "hertz_mindlin": hertz_mindlin.coefficients(HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), SURFACE),
    "linear": linear.coefficients(LinearSpringDashpot(normal_stiffness=5e4), SURFACE),
    **{
        module.__name__.rpartition(".")[2]: module.coefficients(kind(shear_modulus=1e8, poisson_ratio=0.25), SURFACE)
        for module, kind in (
            (hertz_printed, HertzPrinted),
            (hertz_liggghts, HertzLiggghts),
            (hertz_lammps, HertzLammps),
        )
    },
}
COEFFICIENTS["traction"] = COEFFICIENTS["hertz_mindlin"]
COEFFICIENTS |= dict.fromkeys(("hertz", "spheres", "rods", "clumps"), COEFFICIENTS["hertz_mindlin"])
SWITCHES: dict[str, object] = {"FRICTION": True, "ROLLING": True, "TWIST": True, "VARIED": True, "PERIODIC": True}
# ranges of arguments in which every branch of the laws is taken; all others lie between 0.1 and 2
RANGES = {
    "rs": (5e-4, 2e-3),
    "ms": (1e-5, 4e-5),
    "delta": (1e-7, 1e-5),
    "vn": (-0.3, 0.3),
    "torque": (0.0, 1.0),
    "inertia_rate": (0.0, 1.0),
    "radius": (1e-3, 2e-3),
    "mass": (1e-5, 4e-5),
    "ri": (1e-3, 2e-3),
    "rj": (1e-3, 2e-3),
    "mi": (1e-5, 4e-5),
    "mj": (1e-5, 4e-5),
    "rate_i": (0.0, 1.0),
    "rate_j": (0.0, 1.0),
    "overlap2": (1e-9, 1e-7),
    "stiffness": (1e-6, 3e-5),
    "limit": (1e-6, 3e-5),
}
SPREAD = {"s": 3e-6, "before": 1e-5, "vt": 0.1, "away": 2e-3, "lever_i": 3e-3, "lever_j": 3e-3, "lever": 3e-3}
UNITS = ("n", "normal", "along", "a", "b")
WHOLE = {"part": 4, "touched": 16, "touches": 16, "parts": 16, "coordinate": 3, "count": 9}


def device_functions(module: ModuleType) -> list[str]:
    """Names of the functions marked with `func`."""
    tree = ast.parse(source.device_source(module))
    return [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]


LEFT_OUT = (".words", ".source", ".mesh", ".mesh_rods", ".poses")


def physics() -> list[ModuleType]:
    """Every module of labbook_dem that has something to compile, but for meshes: their functions take the tables of a
    surface, and tests/unit/numba/test_numba_mesh.py has whole scenes of them beside the reference."""
    names = [m.name for m in pkgutil.walk_packages(labbook_dem.__path__, "labbook_dem.")]
    modules = [importlib.import_module(name) for name in names if not name.endswith(LEFT_OUT)]
    return [module for module in modules if device_functions(module)]


MODULES = physics()


def needed(module: ModuleType) -> list[ModuleType]:
    """The module and what it calls, in the order of a generated module."""
    law = (contact, *hertz_mindlin.NEEDS, hertz_mindlin)
    if module is contact:
        return [contact]
    return {
        spheres: [*law, spheres],
        rods: [*law, spheres, rods],
        clumps: [*law, spheres, rotation, clumps],
    }.get(module, [contact, *getattr(module, "NEEDS", ()), module])


def kinds(function) -> list[str]:
    """What each argument is, by its annotation in the source."""
    node = ast.parse(inspect.getsource(function)).body[0]
    assert isinstance(node, ast.FunctionDef)
    text = [ast.unparse(a.annotation).replace("section", "wide3") for a in node.args.args if a.annotation]
    assert len(text) == len(node.args.args), f"{function.__name__} lacks annotations"
    assert set(text) <= {"real", "wide", "vec3", "wide3", "coefs", "bool", "int"}, function.__name__
    return text


def arguments(module: ModuleType, function, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Random arguments by name: scalars [COUNT], vectors [COUNT, 3]."""
    found = {}
    for name, kind in zip(inspect.signature(function).parameters, kinds(function), strict=True):
        if kind == "coefs":
            found[name] = np.tile(COEFFICIENTS[module.__name__.rsplit(".", 1)[1]], (COUNT, 1))
        elif kind == "bool":
            found[name] = rng.random(COUNT) < 0.5
        elif kind == "int":
            found[name] = rng.integers(WHOLE[name], size=COUNT).astype(np.int32)
        elif kind in ("vec3", "wide3"):
            vectors = rng.normal(size=(COUNT, 3)) * SPREAD.get(name, 1.0)
            if name in ("along", "rim", "start"):
                vectors = np.abs(vectors) * [1, 0, 1]
            if name in UNITS:
                vectors /= np.linalg.norm(vectors, axis=1)[:, None]
            found[name] = vectors
        else:
            found[name] = rng.uniform(*RANGES.get(name, (0.1, 2.0)), COUNT)
    return found


def flat(result) -> list[float]:
    parts = result if isinstance(result, tuple) else (result,)
    return [x for part in parts for x in ((part.x, part.y, part.z) if isinstance(part, words.vec3) else (part,))]


def row(given: dict[str, np.ndarray], k: int) -> list:
    """Row k of all arguments, in plain Python's words."""
    make = {1: np.ndarray.item, 3: lambda a: words.vec3(*a), 8: tuple}
    return [make[a[k].size](a[k : k + 1] if a[k].size == 1 else a[k]) for a in given.values()]


def in_python(function, given: dict[str, np.ndarray]) -> np.ndarray:
    with choose(LAW):
        return np.array([flat(function(*row(given, k))) for k in range(COUNT)], np.float64)


def shapes(function, given) -> list[bool]:
    """Whether each result is a vector."""
    with choose(LAW):
        result = function(*row(given, 0))
    return [isinstance(part, words.vec3) for part in (result if isinstance(result, tuple) else (result,))]


def loop_text(function, vectors: list[bool], load, store) -> str:
    """Body of a loop over rows k: load arguments, call, store results to columns of `out`."""
    names = list(inspect.signature(function).parameters)
    calls = ", ".join(load(kind, name) for kind, name in zip(kinds(function), names, strict=True))
    results = [f"r{place}" for place in range(len(vectors))]
    lines, column = [f"{', '.join(results)} = {function.__name__}({calls})"], 0
    for result, vector in zip(results, vectors, strict=True):
        for part in (".x", ".y", ".z") if vector else ("",):
            lines.append(store(column, result + part))
            column += 1
    return "\n".join("    " + line for line in lines)


DOUBLE, SINGLE = 1e-13, 2e-5


def in_single(name: str, arguments: list[str]) -> bool:
    """Whether a function computes in single in mixed precision: what it takes says so, but for points sought in single;
    how well these are found has tests of its own, on rods of a size."""
    sought = ("closest", "closest_from", "leaves_plate", "nearest_to_rim", "frustum_edges")
    return name in sought or bool({"real", "vec3"} & set(arguments))


def every_argument(module: ModuleType) -> dict[str, dict[str, np.ndarray]]:
    rng = np.random.default_rng(5)
    return {name: arguments(module, getattr(module, name), rng) for name in device_functions(module)}


def check(name: str, found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Column by column, in units of its largest number."""
    assert np.all(np.isfinite(found)), name
    error = np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0).clip(min=1e-300)
    assert np.all(error <= tolerance), f"{name}: {error}"
