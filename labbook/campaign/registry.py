"""Strategies that a study can name under `adapt`: goals, and strategies of other packages."""

from collections.abc import Sequence
from typing import Any, Union

from pydantic import GetCoreSchemaHandler, create_model
from pydantic_core import CoreSchema, core_schema

from labbook.campaign.find import Find
from labbook.campaign.fit_law import FitLaw
from labbook.campaign.goal import Budgeted, Goal
from labbook.campaign.mapping import Map
from labbook.campaign.strategy import Strategy
from labbook.campaign.transition import Transition
from labbook.plugins import Registry
from labbook.scene.model import Fault, refuse


class Strategies(Registry[type[Strategy]]):
    """Strategies by name; as an annotation, it takes a mapping of one name to the strategy's own keys."""

    def __init__(self, group: str, builtin: Sequence[type[Strategy]] = ()):
        super().__init__(group, Strategy, builtin)

    def __hash__(self) -> int:  # `Annotated` asks for it where a field may also be None
        return id(self)

    def _object_of(self, loaded: Any) -> Any:
        return loaded if isinstance(loaded, type) and issubclass(loaded, Strategy) else None

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        fields: dict[str, Any] = {name: (Union[kind, None], None) for name, kind in self.items()}  # noqa: UP007
        schema = create_model("Adapt", __base__=Budgeted, **fields)
        return core_schema.no_info_before_validator_function(
            _mapping, core_schema.no_info_after_validator_function(_only, handler.generate_schema(schema))
        )


def _mapping(mapping: Any) -> Any:
    """Convert a strategy built in Python to the mapping that a study has."""
    return {mapping.name: mapping} if isinstance(mapping, Strategy) else mapping


def _only(adapt: Budgeted) -> Strategy:
    names = [name for name in type(adapt).model_fields if name != "budget"]
    strategies = [strategy for name in names if (strategy := getattr(adapt, name)) is not None]
    if len(strategies) != 1:
        refuse(
            [
                Fault(
                    "", f"{len(strategies)} strategies are named, and one is needed", f"name one of: {', '.join(names)}"
                )
            ]
        )
    (strategy,) = strategies
    if adapt.budget is None:
        return strategy
    if not isinstance(strategy, Goal):
        refuse([Fault("budget", f"the strategy {strategy.name} has no budget", "leave it out")])
    return strategy.model_copy(update={"budget": adapt.budget.runs, "device_time": adapt.budget.device_time})


STRATEGIES = Strategies("labbook.strategies", (Find, FitLaw, Transition, Map))
"""Strategies that a study can name under `adapt`."""
