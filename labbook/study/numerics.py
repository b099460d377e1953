"""The `numerics` section of a study, resolved for a scene."""

from collections.abc import Mapping
from typing import Any

from labbook.numerics import Numerics
from labbook.scene.scene import Scene
from labbook.study import timestep


def resolve(stated: Mapping[str, Any], scene: Scene) -> Numerics:
    """Numerics with the step that `stated` asks for in `scene`.

    Raises pydantic's ValidationError for any key but `dt`, and TimeStepError for that.
    """
    context = {"units": "required", "d": scene.grains.diameter}
    settings = {key: value for key, value in stated.items() if key != "dt"}
    numerics = Numerics.model_validate({**settings, "dt": "1 us"}, context=context)
    dt = timestep.resolve(stated.get("dt"), scene, numerics.stiffness_scale)
    return numerics.model_copy(update={"dt": dt})
