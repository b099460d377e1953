"""Numbers and keys as people read them: millimetres, degrees, g/s; no more digits than the error allows."""

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Shown:
    """How a quantity is shown: its name, the unit shown, and the factor from SI to it."""

    name: str
    unit: str = ""
    scale: float = 1.0

    @property
    def heading(self) -> str:
        """Name with its unit, as on an axis or above a column."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name


_MM, _DEGREE = 1e3, 180 / math.pi

KEYS = {
    "container.orifice": Shown("D", "mm", _MM),
    "container.angle": Shown("angle", "deg", _DEGREE),
    "container.gap": Shown("gap", "mm", _MM),
    "container.width": Shown("width", "mm", _MM),
    "container.height": Shown("height", "mm", _MM),
    "container.thickness": Shown("thickness", "mm", _MM),
    "grains.diameter": Shown("d", "mm", _MM),
    "grains.length": Shown("L", "mm", _MM),
    "grains.density": Shown("density", "kg/m³"),
    "container.rotation": Shown("f", "Hz"),
    "contact.shear_modulus": Shown("shear modulus", "MPa", 1e-6),
    "contact.normal_stiffness": Shown("k_n", "N/m"),
    "numerics.dt": Shown("dt", "µs", 1e6),
    "gravity": Shown("g", "m/s²"),
    "fill.friction": Shown("friction while filling"),
    "fill.max_time": Shown("longest filling", "s"),
}

QUANTITIES = {  # a superscript is written ^(...)
    "flow_rate": Shown("W", "g/s", 1e3),
    "flow_rate_flowing": Shown("W of clogged runs while flowing", "g/s", 1e3),
    "grain_rate": Shown("Q", "1/s"),
    "grain_rate_flowing": Shown("Q of clogged runs while flowing", "1/s"),
    "flow_rate_drift": Shown("drift of W", "%", 100),
    "flow_rate_drift_flowing": Shown("drift of W of clogged runs", "%", 100),
    "gap_time": Shown("time without flow", "s"),
    "packing_fraction": Shown("φ"),
    "packing_fraction_2d": Shown("φ in 2D"),
    "hexatic_local": Shown("ψ₆ local"),
    "hexatic_global": Shown("ψ₆ global"),
    "orifice.packing_fraction": Shown("φ"),
    "orifice.v_z": Shown("v_z", "m/s"),
    "orifice.kinetic_pressure": Shown("p_k", "Pa"),
    "orifice.O_zz": Shown("O_zz"),
    "orifice.O_rr": Shown("O_rr"),
    "orifice.O_tt": Shown("O_tt"),
    "orifice_packing_fraction": Shown("⟨φ⟩"),
    "orifice_v_z": Shown("⟨v_z⟩", "m/s"),
    "orifice_kinetic_pressure": Shown("⟨p_k⟩", "Pa"),
    "orifice_contact_pressure": Shown("⟨p_c⟩", "Pa"),
    "orifice_O_zz": Shown("⟨O_zz⟩"),
    "orifice_O_rr": Shown("⟨O_rr⟩"),
    "orifice_O_tt": Shown("⟨O_tt⟩"),
    "orifice_S": Shown("⟨S⟩"),
    "bed_contact_pressure": Shown("p_c in the bed", "Pa"),
    "free_fall_height": Shown("free fall", "mm", _MM),
    "orifice.stagnant_fraction": Shown("stagnant", "%", 100),
    "flow_ratio.angle": Shown("W/W of the flat bottom"),
    "flow_ratio.position": Shown("W/W in the middle"),
    "outlet_closure": Shown("flow of the profiles / W"),
    "outlet_area_fraction": Shown("mean φ at the outlet"),
    "outlet_velocity": Shown("mean v at the outlet", "m/s"),
    "outlet_profiles.a": Shown("a"),
    "outlet_profiles.gamma": Shown("γ"),
    "outlet_profiles.b": Shown("b"),
    "outlet_profiles.phi_inf": Shown("φ_∞"),
    "outlet_profiles.tau1": Shown("τ₁"),
    "outlet_profiles.tau2": Shown("τ₂", "1/mm", 1 / _MM),
    "outlet_profiles.delta1": Shown("δ₁"),
    "outlet_profiles.delta2": Shown("δ₂"),
    "outlet_profiles.epsilon1": Shown("ε₁"),
    "outlet_profiles.epsilon2": Shown("ε₂"),
    "outlet_profiles.sigma1": Shown("σ₁"),
    "outlet_profiles.sigma2": Shown("σ₂"),
    "beverloo.slope": Shown("slope of W^(2/3)", "(g/s)^(2/3)/mm", 1e2 / _MM),
    "janda.alpha2": Shown("α₂", "mm", _MM),
    "janda.alpha1": Shown("α₁"),
    "janda.alpha2_over_d": Shown("α₂/d"),
    "janda.C_prime": Shown("C′", "1/(s mm^(3/2))", _MM**-1.5),
    "janda_3d.alpha2": Shown("α₂", "mm", _MM),
    "janda_3d.alpha1": Shown("α₁"),
    "janda_3d.alpha2_over_d": Shown("α₂/d"),
    "janda_3d.C_prime": Shown("C′", "1/(s mm^(5/2))", _MM**-2.5),
    "beverloo_3d.slope": Shown("slope of W^(2/5)", "(g/s)^(2/5)/mm", 1e3**0.4 / _MM),
    "beverloo_3d.C": Shown("C (bulk density)"),
    "beverloo_3d.C_particle": Shown("C (grain density)"),
    "beverloo_3d.k": Shown("k"),
    "power.n": Shown("n"),
    "power.W_d": Shown("W at D = d", "g/s", 1e3),
    "exponential.kappa": Shown("κ", "1/mm", 1 / _MM),
    "exponential.W_0": Shown("W at D = 0", "g/s", 1e3),
    "beverloo.C": Shown("C (bulk density)"),
    "beverloo.C_particle": Shown("C (grain density)"),
    "beverloo.k": Shown("k"),
}
QUANTITIES |= {  # of its approach to what it is in the middle, limit - depth e^{-rate s*}
    f"outlet_profiles.{name}.{term}": Shown(said.format(QUANTITIES[f"outlet_profiles.{name}"].name))
    for name in ("delta1", "sigma1", "delta2", "sigma2")
    for term, said in (("limit", "limit of {}(s*)"), ("depth", "depth of {}(s*)"), ("rate", "rate of {}(s*)"))
}
QUANTITIES |= {  # the same parameters of profiles by another definition
    name.replace("outlet_profiles", "outlet_crossings"): replace(shown, name=f"{shown.name} (crossings)")
    for name, shown in QUANTITIES.items()
    if name.startswith("outlet_profiles")
}


def key(name: str) -> Shown:
    """How the dotted key of a study is shown; an unknown one by its last part, in SI."""
    shown = KEYS.get(name, Shown(name.rsplit(".", 1)[-1].replace("_", " ")))
    if name.startswith("walls."):
        which = name.split(".")[1]
        shown = replace(shown, name=f"{shown.name} of {'all walls' if which == 'all' else f'wall {which}'}")
    return shown


def quantity(name: str, unit: str = "") -> Shown:
    """How a measured or fitted quantity is shown; an unknown one by its own name, in SI (`unit`)."""
    return QUANTITIES.get(name, Shown(name.rsplit(".", 1)[-1].replace("_", " "), unit))


_WORDS = {
    "container.orifice": "orifice D",
    "container.rotation": "rotation f",
    "contact.normal_stiffness": "stiffness k_n",
    "grains.diameter": "diameter d",
    "grains.length": "length L",
    "gravity": "gravity g",
    "numerics.dt": "time step",
}


def spoken(name: str) -> str:
    """What the dotted key of a study is called in a sentence or a title: with a word where it is shown as a symbol."""
    return _WORDS.get(name, key(name).name)


def percentage(part: float) -> str:
    """`±2.4 %` of a relative half-width, to two digits; `unknown` where it has no end."""
    if not math.isfinite(part):
        return "unknown"
    return f"±{100 * part:.2g} %" if 100 * part < 99.5 else f"±{100 * part:.0f} %"


def amount(name: str, value: float | str) -> str:
    """The value of a key, without its unit; words as they are."""
    return value if isinstance(value, str) else f"{value * key(name).scale:.6g}"


def setting(name: str, value: float | str) -> str:
    """`D = 30 mm` of a key and its value in SI, or the word that it takes."""
    shown = key(name)
    return f"{shown.name} = {amount(name, value)} {shown.unit}".rstrip()


def label(at: Mapping[str, float | str], leave_out: Collection[str] = ()) -> str:
    """`width = 100 mm, D = 30 mm`: what was swept, but for keys to leave out."""
    return ", ".join(setting(name, value) for name, value in at.items() if name not in leave_out)


def number(value: float, error: float | None = None, scale: float = 1.0) -> str:
    """`value` times `scale`, to the digits that two significant digits of its error ask for; five without an error."""
    value = value * scale
    if not math.isfinite(value):
        return {math.inf: "∞", -math.inf: "−∞"}.get(value, "–")
    if error is None or not math.isfinite(error) or error <= 0:
        return _minus(f"{value:.4g}")
    error = error * scale
    decimals = 1 - math.floor(math.log10(error))
    if decimals < 0 or decimals > 8:
        return _minus(f"{value:.4g}")
    return _minus(f"{value:.{decimals}f}")


def with_error(value: float, error: float, scale: float = 1.0) -> str:
    """`55.82 ± 0.31`; the error is left out where it is not known."""
    if not math.isfinite(error):
        return number(value, None, scale)
    return f"{number(value, error, scale)} ± {number(error, error, scale)}"


def _minus(text: str) -> str:
    return text.replace("-", "−")
