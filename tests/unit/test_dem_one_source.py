"""Every function of the physics, compiled by Numba and by Warp from its one source, gives what plain Python gives."""

import ast
import importlib
import importlib.util
import inspect
import math
import pkgutil
import sys
from types import ModuleType

import labbook_dem
import numpy as np
import pytest
from labbook_dem import contact, rods, source, spheres, words
from labbook_dem.laws import hertz_mindlin, linear

from labbook.scene import HertzMindlin, LinearSpringDashpot, Surface

COUNT = 400
SURFACE = Surface(friction=0.5, rolling_friction=0.01, restitution=0.2)
COEFFICIENTS = {
    "hertz_mindlin": hertz_mindlin.coefficients(HertzMindlin(shear_modulus=1e8, poisson_ratio=0.25), SURFACE),
    "linear": linear.coefficients(LinearSpringDashpot(normal_stiffness=5e4), SURFACE),
}
COEFFICIENTS["spheres"] = COEFFICIENTS["rods"] = COEFFICIENTS["hertz_mindlin"]
SWITCHES: dict[str, object] = {"FRICTION": True, "ROLLING": True, "TWIST": True, "VARIED": True}
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
    "gap": (1e-9, 1e-7),
}
SPREAD = {"s": 3e-6, "vt": 0.1, "away": 2e-3, "lever_i": 3e-3, "lever_j": 3e-3, "lever": 3e-3}
UNITS = ("n", "normal", "along", "a", "b")
WHOLE = {"part": 4, "was": 16, "now": 16, "parts": 16}


def device_functions(module: ModuleType) -> list[str]:
    """Names of the functions marked with `func`."""
    tree = ast.parse(source.device_source(module))
    return [node.name for node in tree.body if isinstance(node, ast.FunctionDef)]


def physics() -> list[ModuleType]:
    """Every module of labbook_dem that has something to compile."""
    names = [m.name for m in pkgutil.walk_packages(labbook_dem.__path__, "labbook_dem.")]
    modules = [importlib.import_module(name) for name in names if not name.endswith((".words", ".source"))]
    return [module for module in modules if device_functions(module)]


MODULES = physics()


def needed(module: ModuleType) -> list[ModuleType]:
    """The module and what it calls, in the order of a generated module."""
    return {spheres: [hertz_mindlin, contact, spheres], rods: [hertz_mindlin, contact, spheres, rods]}.get(
        module, [module]
    )


def kinds(function) -> list[str]:
    """What each argument is, by its annotation in the source."""
    node = ast.parse(inspect.getsource(function)).body[0]
    assert isinstance(node, ast.FunctionDef)
    text = [ast.unparse(a.annotation) for a in node.args.args if a.annotation]
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
            if name in ("along", "rim"):
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
    return np.array([flat(function(*row(given, k))) for k in range(COUNT)], np.float64)


def shapes(function, given) -> list[bool]:
    """Whether each result is a vector."""
    result = function(*row(given, 0))
    return [isinstance(part, words.vec3) for part in (result if isinstance(result, tuple) else (result,))]


def compiled(text: str, name: str, folder) -> ModuleType:
    path = folder / f"{name}.py"
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


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


# Numba


def numba_module(module: ModuleType, given: dict, precision: str, folder) -> ModuleType:
    from labbook_numba import dialect

    def load(kind, name):
        if kind in ("vec3", "wide3"):
            return f"{kind}({name}[k, 0], {name}[k, 1], {name}[k, 2])"
        if kind == "coefs":
            return "(" + ", ".join(f"real({name}[k, {c}])" for c in range(8)) + ")"
        return f"{name}[k]" if kind in ("bool", "int") else f"{kind}({name}[k])"

    loops = []
    for name in device_functions(module):
        function = getattr(module, name)
        body = loop_text(function, shapes(function, given[name]), load, lambda c, r: f"out[k, {c}] = {r}")
        body = body.replace("\n", "\n    ").replace("    r0", "        r0", 1)
        head = f"@njit\ndef run_{name}(out, {', '.join(given[name])}):\n    for k in range(len(out)):\n"
        loops.append(head + body)
    text = source.generate(dialect.header(precision), SWITCHES, needed(module)) + "\n\n" + "\n\n\n".join(loops)
    return compiled(text, f"numba_{precision}_{module.__name__.replace('.', '_')}", folder)


@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("module", MODULES, ids=lambda m: m.__name__)
def test_numba_agrees_with_python(module, precision, tmp_path):
    pytest.importorskip("numba")
    given = every_argument(module)
    made = numba_module(module, given, precision, tmp_path)
    for name, values in given.items():
        expected = in_python(getattr(module, name), values)
        out = np.empty_like(expected)
        getattr(made, f"run_{name}")(out, *values.values())
        single = precision == "mixed" and in_single(name, kinds(getattr(module, name)))
        check(name, out, expected, SINGLE if single else DOUBLE)


# Warp: its words for the same vocabulary

WARP = """\
import warp as wp

func = wp.func
real = wp.{real}
wide = wp.float64
vec3 = wp.{vec3}
wide3 = wp.vec3d
coefs = wp.types.vector(length=8, dtype=real)
dot = wp.dot
cross = wp.cross
sqrt = wp.sqrt


@wp.func
def narrow(v: wide3):
    return vec3(real(v[0]), real(v[1]), real(v[2]))
"""


def warp_module(module: ModuleType, given: dict, precision: str, folder) -> ModuleType:
    header = (
        WARP.format(real="float64", vec3="vec3d")
        if precision == "double"
        else WARP.format(real="float32", vec3="vec3f")
    )
    kernels = []
    for name in device_functions(module):
        function = getattr(module, name)
        vectors = shapes(function, given[name])
        body = loop_text(function, vectors, lambda kind, n: f"{n}[k]", lambda c, r: f"out[k, {c}] = wp.float64({r})")
        arguments = ", ".join(
            f"{n}: wp.array(dtype={kind})" for n, kind in zip(given[name], kinds(function), strict=True)
        )
        kernels.append(
            f"@wp.kernel\ndef run_{name}(out: wp.array2d(dtype=wp.float64), {arguments}):\n    k = wp.tid()\n{body}"
        )
    text = source.generate(header, SWITCHES, needed(module)) + "\n\n" + "\n\n\n".join(kernels) + "\n"
    return compiled(text, f"warp_{precision}_{module.__name__.replace('.', '_')}", folder)


@pytest.mark.parametrize("precision", ["double", "mixed"])
@pytest.mark.parametrize("module", MODULES, ids=lambda m: m.__name__)
def test_warp_agrees_with_python(module, precision, tmp_path):
    wp = pytest.importorskip("warp", reason="Warp is not installed: pip install 'labbook[warp]'")
    wp.config.quiet = True
    wp.config.kernel_cache_dir = str(tmp_path / "cache")
    given = every_argument(module)
    made = warp_module(module, given, precision, tmp_path)
    types = {"real": made.real, "wide": made.wide, "vec3": made.vec3, "wide3": made.wide3}
    types |= {"coefs": made.coefs, "bool": bool, "int": int}
    for name, values in given.items():
        function = getattr(module, name)
        expected = in_python(function, values)
        out = wp.zeros(expected.shape, dtype=wp.float64, device="cpu")
        inputs = [
            wp.array(a, dtype=types[kind], device="cpu")
            for a, kind in zip(values.values(), kinds(function), strict=True)
        ]
        wp.launch(getattr(made, f"run_{name}"), dim=COUNT, inputs=[out, *inputs], device="cpu")
        single = precision == "mixed" and in_single(name, kinds(function))
        check(name, out.numpy(), expected, SINGLE if single else DOUBLE)


DOUBLE, SINGLE = 1e-13, 2e-5


def in_single(name: str, arguments: list[str]) -> bool:
    """Whether a function computes in single in mixed precision: what it takes says so, but for closest points."""
    return name in ("closest", "closest_from") or bool({"real", "vec3"} & set(arguments))


def every_argument(module: ModuleType) -> dict[str, dict[str, np.ndarray]]:
    rng = np.random.default_rng(5)
    return {name: arguments(module, getattr(module, name), rng) for name in device_functions(module)}


def check(name: str, found: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    """Column by column, in units of its largest number."""
    assert np.all(np.isfinite(found)), name
    error = np.abs(found - expected).max(axis=0) / np.abs(expected).max(axis=0).clip(min=1e-300)
    assert np.all(error <= tolerance), f"{name}: {error}"


MIXED = """
from functools import lru_cache
from labbook_dem.words import func, real


@lru_cache(maxsize=8)
def table(n):
    return [twice(real(k)) for k in range(n)]


@func
def twice(a: real):
    return real(2.0) * a


def plain(a):
    return a


@kernel
def loop(x):
    x[0] = twice(x[0])
"""


def test_only_marked_functions_are_taken_to_the_compiler(tmp_path):
    module = ModuleType("mixed")
    module.__file__ = str(tmp_path / "mixed.py")
    (tmp_path / "mixed.py").write_text(MIXED)
    assert device_functions(module) == ["twice", "loop"]
    assert source.device_source(module).startswith("@func\ndef twice")
    assert "lru_cache" not in source.generate("", {}, [module])
    (tmp_path / "mixed.py").write_text(MIXED.replace("@func", "@lru_cache(maxsize=8)\n@func"))
    with pytest.raises(ValueError, match=r"twice: .* has one decorator"):
        source.device_source(module)


def test_a_host_module_with_cached_functions_has_nothing_to_compile():
    from labbook_dem import restitution

    assert source.device_source(restitution) == ""


# the comparison means something only if it reaches every branch


def test_all_of_the_physics_is_compared():
    names = {f"{module.__name__}.{name}" for module in MODULES for name in device_functions(module)}
    for law in ("hertz_mindlin", "linear"):
        assert {f"labbook_dem.laws.{law}.respond", f"labbook_dem.laws.{law}.normal"} <= names
    for wall in ("plane", "strip", "frustum"):
        assert {f"labbook_dem.walls.{wall}.{wall}_distance", f"labbook_dem.walls.{wall}.{wall}_rod"} <= names
    assert {"labbook_dem.rods.rod_on_rod", "labbook_dem.segments.closest", "labbook_dem.rotation.turn"} <= names
    assert {"labbook_dem.motion.kick", "labbook_dem.contact.slip", "labbook_dem.contact.rolling"} <= names


@pytest.mark.parametrize("module", [hertz_mindlin, linear], ids=lambda m: m.__name__)
def test_arguments_reach_every_branch_of_the_laws(module):
    given = every_argument(module)["respond"]
    out = in_python(module.respond, given)
    fn, ft = out[:, 0], np.linalg.norm(out[:, 1:4], axis=1)
    slides = np.isclose(ft, 0.5 * fn, rtol=1e-9) & (fn > 0)
    assert np.sum(fn == 0) > 5
    assert np.sum(slides) > 20
    assert np.sum(~slides & (fn > 0)) > 20
    assert math.isfinite(out.sum())
