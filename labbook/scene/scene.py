"""A scene: all that decides how grains move, and nothing else."""

from pydantic import model_validator
from pydantic_core import PydanticCustomError

from labbook.scene.contact import ContactLaw, Surface
from labbook.scene.container import Container, WedgeHopper
from labbook.scene.grains import Grains
from labbook.scene.model import Model
from labbook.scene.quantities import Acceleration
from labbook.scene.walls import Wall

STANDARD_GRAVITY = 9.81


class Scene(Model):
    """Grains, the law of their contacts, the container and the surfaces of its walls, and gravity [m/s^2] along -z."""

    grains: Grains
    contact: ContactLaw
    container: Container
    walls: dict[str, Surface] = {}
    """Surfaces that differ from the grains': by wall name, or `all`."""
    gravity: Acceleration = STANDARD_GRAVITY

    @model_validator(mode="after")
    def _fits_together(self):
        names = self.wall_names
        for name in self.walls:
            if name not in names:
                raise PydanticCustomError(
                    "geometry",
                    "{reason}",
                    {
                        "key": f"walls.{name}",
                        "reason": f"the container has no wall named {name}",
                        "remedy": f"use one of {', '.join(sorted(names))}",
                    },
                )
        c = self.container
        if isinstance(c, WedgeHopper):
            for key, size in (("thickness", c.thickness), ("orifice", c.orifice)):
                if size < self.grains.diameter:
                    raise PydanticCustomError(
                        "geometry",
                        "{reason}",
                        {
                            "key": f"container.{key}",
                            "reason": f"the {key} ({size * 1e3:g} mm) is less than the grain diameter",
                            "remedy": f"make it at least {self.grains.diameter * 1e3:g} mm (1 d)",
                        },
                    )
        return self

    @property
    def wall_names(self) -> set[str]:
        """Names that `walls` may use: `all`, and every wall of the container, open or closed."""
        parts = (*self.container.walls(), *self.container.close().walls())
        return {"all", *(wall.name for wall in parts)}

    def surface(self, wall: Wall) -> Surface:
        """The complete surface of `wall`: its own, else that of `all`, else the grains'."""
        c = self.contact
        own = Surface(friction=c.friction, rolling_friction=c.rolling_friction, restitution=c.restitution)
        return self.walls.get(wall.name, Surface()).over(self.walls.get("all", Surface()).over(own))

    def close(self, friction: float | None = None) -> "Scene":
        """The scene in which a packing for this one is made; `friction` replaces that of grains and walls alike."""
        container = self.container.close()
        names = {"all", *(wall.name for wall in container.walls())}
        walls = {name: surface for name, surface in self.walls.items() if name in names}
        contact = self.contact
        if friction is not None:
            contact = contact.model_copy(update={"friction": friction})
            walls = {name: s.model_copy(update={"friction": None}) for name, s in walls.items()}
            walls = {name: s for name, s in walls.items() if s != Surface()}
        return self.model_copy(update={"container": container, "contact": contact, "walls": walls})
