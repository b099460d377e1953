"""One key of a study: what it takes and what it means."""

from dataclasses import dataclass

from labbook.scene.scene import Scene

NEGLIGIBLE, ENORMOUS = 1e-3, 1e3
"""Limits of a range beyond these only keep numbers finite and are not shown as limits."""

EXAMPLES = {
    "m": "30 mm",
    "rad": "45 deg",
    "kg/m^3": "2500 kg/m^3",
    "Pa": "100 MPa",
    "": "0.5",
    "m/s^2": "9.81 m/s^2",
    "s": "10 ms",
    "N/m": "1e4 N/m",
    "Hz": "0.5 Hz",
    "m/s": "1 m/s",
    "rad/s": "1 rad/s",
}


@dataclass(frozen=True)
class Key:
    """One key. `name` is dotted; `*` stands for a wall's name, `[]` for the items of a list."""

    name: str
    type: str
    """`quantity`, `integer`, `text`, `true or false`, `choice` or `list of ...`."""
    unit: str | None = None
    """SI unit of a quantity; "" for a number without unit."""
    limits: str = ""
    """Range in words, for example `in (0, 1]` or `above 0`."""
    choices: tuple[str, ...] = ()
    default: str | None = None
    """As it would be written; None: the key is required."""
    meaning: str = ""
    of: str = ""
    """The choice that the key belongs to, for example `kind: box`; empty: to all."""

    @property
    def sweepable(self) -> bool:
        """Whether a sweep may vary it: a single value of the scene, the filling or the numerics."""
        top = self.name.split(".")[0]
        single = self.type in ("quantity", "integer", "choice", "true or false") and "[]" not in self.name
        return single and (top in Scene.model_fields or top in ("fill", "numerics"))

    @property
    def remedy(self) -> str:
        """What may be written here."""
        if self.choices:
            return f"use one of: {', '.join(self.choices)}"
        within = f" {self.limits}" if self.limits else ""
        if self.type == "quantity":
            return f"write a {'quantity' if self.unit else 'number'}{within}, for example {self.example}"
        if self.type == "text":
            return f"write text ({self.meaning.rstrip('.')})"
        kind = {"integer": "a whole number", "true or false": "true or false"}.get(self.type, f"a {self.type}")
        return f"write {kind}{within}"

    @property
    def example(self) -> str:
        """A quantity of the right unit."""
        return EXAMPLES.get(self.unit or "", f"1 {self.unit}")
