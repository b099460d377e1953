"""What is compiled in, stated by hand: for tests that make kernels without a scene."""

from typing import Any

from labbook_dem.features import SWITCHES

from labbook.backend import Spec


def spec(law: str = "linear", precision: str = "double", **features: Any) -> Spec:
    """Spheres without walls and with nothing switched on, but for `features`."""
    plain = {"law": law, "precision": precision, "shape": "sphere", "walls": (), "LISTED": False}
    switches = dict.fromkeys(SWITCHES, False) | {"KINDS": 1}
    return Spec("", tuple(sorted({**plain, **switches, **features}.items())))
