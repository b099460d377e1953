"""Words that users of other codes (LIGGGHTS, LAMMPS, YADE, MercuryDPM) write, and what they are called here."""

import re
from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from labbook.scene.quantities import parse


@dataclass(frozen=True)
class Habit:
    """Remedy for a word of another code.

    Args:
        remedy: The remedy in words.
        key: Dotted key that has the meaning of the word; None if there is none.
    """

    remedy: str
    key: str | None = None


_SYNONYMS = {
    "contact.restitution": "coefficientofrestitution restitutioncoefficient coefficientrestitution cor en e",
    "contact.friction": "mu mus coefficientoffriction coefficientfriction frictioncoefficient slidingfriction xmu",
    "contact.rolling_friction": "mur rollingfrictioncoefficient coefficientrollingfriction",
    "contact.rolling_damping": "etar coefficientrollingviscousdamping coeffrollvisc",
    "contact.rolling_stiffness": "coeffrollingstiffness",
    "contact.rolling_model": "rollingmodel rollingfrictionmodel",
    "contact.poisson_ratio": "poisson poissonsratio poissonratio nu",
    "contact.normal_stiffness": "kn stiffness springconstant knormal",
    "grains.count": "n number numberofgrains numberofparticles nparticles ngrains natoms particles",
    "grains.density": "rho particledensity",
    "numerics.dt": "timestep dt deltat",
    "container.orifice": "outlet hole aperture opening outletdiameter outletwidth orificewidth orificediameter",
}
KEYS_BY_HABIT = {word: key for key, words in _SYNONYMS.items() for word in words.split()}
_YOUNG = frozenset(("e", "young", "youngs", "youngmodulus", "youngsmodulus", "elasticmodulus", "ymod", "emodulus"))
_ADVICE = {
    "study": "write name",
    "title": "write name; `about` may hold a sentence",
    "units": "leave it out: every quantity states its own unit, for example 3 mm",
    "seed": "leave it out: the seeds of replicates are 1, 2, 3 ...; use replicates",
    "seeds": "use replicates: their seeds are 1, 2, 3 ...",
    "run": "use stop: {max_time: ...} and stop: {discharged: ...}",
    "steps": "use stop: {max_time: ...}; steps follow from numerics.dt",
    "nsteps": "use stop: {max_time: ...}; steps follow from numerics.dt",
    "dump": "use record: {every: 10 ms}",
    "output": "use record: {every: 10 ms}; `labbook export` writes tables and VTK files",
    "skindistance": "use numerics: {skin: 0.15}, in grain diameters",
}


def habit(key: str, value: Any, siblings: Collection[str]) -> Habit | None:
    """Remedy for an unknown key that is a word of another code.

    Args:
        key: The dotted key.
        value: Its value, from which the remedy may compute a number.
        siblings: Keys of its section.

    Returns:
        The remedy; None if it is no word of another code.
    """
    section, _, leaf = key.rpartition(".")
    word = re.sub(r"[^a-z]", "", leaf.lower())
    # e is a modulus where it has the unit of one, a restitution else
    if word in _YOUNG and (word != "e" or leaf == "E" or _pascals(value) is not None):
        # what is missing then is the modulus by its other name
        inside = section == "contact" or "youngs_modulus" in siblings
        remedy = "write youngs_modulus" if inside else "write contact: {youngs_modulus: ...}"
        return Habit(remedy, f"{section if inside else 'contact'}.shear_modulus")
    if word in ("radius", "r", "rad"):
        if section and "diameter" not in siblings:
            return None
        return _diameter(value, f"{section}.diameter" if section else None)
    if word == "frictionangle":
        return Habit("write friction, the tangent of that angle", "contact.friction")
    target = KEYS_BY_HABIT.get(word)
    if target is not None and target != key:
        where, _, name = target.rpartition(".")
        if section and name in siblings:  # walls have a friction of their own, kinds of grains a density
            return Habit(f"write {name}", f"{section}.{name}")
        return Habit(f"write {name}" if where == section else f"write {where}: {{{name}: ...}}", target)
    if word in _ADVICE:
        return Habit(_ADVICE[word])
    return None


def _diameter(value: Any, key: str | None) -> Habit:
    try:
        size = parse(value, "m") if isinstance(value, str) else None
    except ValueError:
        size = None
    return Habit("write diameter, twice the radius" if size is None else f"write diameter: {2e3 * size:g} mm", key)


def _pascals(value: Any) -> float | None:
    try:
        return parse(value, "Pa") if isinstance(value, str) else None
    except ValueError:
        return None
