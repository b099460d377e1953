"""Every function of the physics, compiled by Numba and by Warp from its one source, gives what plain Python gives."""

import math
from types import ModuleType

import numpy as np
import pytest
from labbook_dem import contact, generated, source
from labbook_dem.laws import hertz_mindlin, linear
from one_source import (
    COUNT,
    DOUBLE,
    MODULES,
    SINGLE,
    SWITCHES,
    check,
    device_functions,
    every_argument,
    in_python,
    in_single,
    kinds,
    loop_text,
    needed,
    shapes,
)

pytestmark = pytest.mark.compiles

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
    return generated.load(f"numba_{precision}_{module.__name__.replace('.', '_')}", text, folder)


@pytest.mark.parametrize("precision", ["double", pytest.param("mixed", marks=pytest.mark.ring)])
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


SMALL = """

@njit(fastmath=FAST, error_model="numpy")
def run_cut(x, limit, into):
    for k in range(x.size):
        into[k] = cut(vec3(x[k], real(0.0), real(0.0)), limit[k]).x


@njit(fastmath=FAST, error_model="numpy")
def run_rolling(x, limit, into):
    for k in range(x.size):
        n = vec3(real(0.0), real(0.0), real(1.0))
        into[k] = rolling(vec3(x[k], real(0.0), real(0.0)), n, limit[k], real(1.0), True).x
"""


@pytest.mark.parametrize("name", ["cut", "rolling"])
def test_what_is_cut_to_nothing_is_nothing_however_small(name, tmp_path):
    """Loops over single precision divide by approximate reciprocals, which take a subnormal square for zero."""
    pytest.importorskip("numba")
    from labbook_numba import dialect

    text = source.generate(dialect.header("mixed"), SWITCHES, [contact]) + SMALL
    made = generated.load(f"small_{name}", text, tmp_path)
    x = (10.0 ** np.arange(-45, 18, 0.01)).astype(np.float32)
    into = np.full_like(x, np.nan)
    getattr(made, f"run_{name}")(x, np.zeros_like(x), into)
    assert np.all(into == 0)


# Warp: its words for the same vocabulary


WARP = """\
import warp as wp

func = wp.func
real = wp.{real}
wide = wp.float64
vec3 = wp.{vec3}
wide3 = section = wp.vec3d
coefs = wp.types.vector(length=8, dtype=real)
dot = wp.dot
cross = wp.cross
sqrt = wp.sqrt
rounded = real


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
    return generated.load(f"warp_{precision}_{module.__name__.replace('.', '_')}", text, folder)


@pytest.mark.ring  # of the words of both backends numba's are tried above, and Warp's by its contract
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


# the comparison means something only if it reaches every branch


def test_all_of_the_physics_is_compared():
    names = {f"{module.__name__}.{name}" for module in MODULES for name in device_functions(module)}
    for law in ("hertz_mindlin", "hertz_printed", "hertz_liggghts", "hertz_lammps", "linear"):
        assert f"labbook_dem.laws.{law}.respond" in names
    assert {"labbook_dem.laws.hertz.normal", "labbook_dem.laws.linear.normal"} <= names
    for wall in ("plane", "strip", "frustum"):
        assert {f"labbook_dem.walls.{wall}.{wall}_distance", f"labbook_dem.walls.{wall}.{wall}_rod"} <= names
    assert "labbook_dem.walls.thick_plate.thick_plate_distance" in names
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
