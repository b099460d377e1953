"""Proposals of strategies in a lab, with their reasons: `lab/campaigns/NAME-KEY.json`.

The key is a hash of everything that proposals depend on: the strategy with its version and options, the study and the
backend. Each file is written in one piece. Several processes that share a campaign use the proposal that the first of
them has written.
"""

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from labbook.campaign import Assignment, Campaign, Generation, Proposal, Strategy
from labbook.campaign.campaign import Proposed, with_proposal
from labbook.lab.folder import LabError, LabFolder, make_folder, open_file, write_bytes
from labbook.scene.model import digest
from labbook.study import Study
from labbook.study.proposed import with_points

_BESIDE = ("about", "fit", "record", "reference")
"""Sections of a study on which no proposal rests: results of the same runs are shown in other ways."""


class _Frozen(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class _Assignment(_Frozen):
    at: dict[str, float | str]
    replicates: int


class _Generation(_Frozen):
    reason: str
    assignments: tuple[_Assignment, ...]


class _Record(_Frozen):
    """The file of a campaign."""

    study: str
    strategy: str
    version: int
    options: dict[str, Any]
    generations: tuple[_Generation, ...] = ()
    ended: str | None = None


class CampaignFile:
    """The file of one campaign in a lab.

    Attributes:
        path: Its file.
    """

    def __init__(self, lab: LabFolder, study: Study, strategy: Strategy, backend: str):
        """Find the file of a campaign.

        Args:
            lab: Has the file.
            study: As its author stated it.
            strategy: Proposes.
            backend: Name of the backend whose runs are looked at.
        """
        sections = {name: section for name, section in study.definition.items() if name not in _BESIDE}
        options = strategy.model_dump(mode="json")
        # all that proposals follow from: a changed study begins a campaign of its own
        key = digest([sections, strategy.name, strategy.version, options, backend])
        self.path = lab.campaigns / f"{study.name}-{key}.json"
        self._lab = lab
        self._head = {"study": study.name, "strategy": strategy.name, "version": strategy.version, "options": options}

    def read(self) -> Proposed:
        """Read the proposals in the file; none if there is no file. Raises LabError for a damaged file."""
        try:
            with open_file(self.path) as file:
                record = _Record.model_validate_json(file.read())
        except FileNotFoundError:
            return Proposed()
        except (OSError, ValidationError) as problem:
            why = str(problem).splitlines()[0]
            remedy = "remove it: the same is proposed again, and no finished run is repeated"
            raise LabError(f"{self.path}: cannot be read ({why}); {remedy}") from problem
        generations = []
        for number, generation in enumerate(record.generations):
            assignments = tuple(
                Assignment(assignment.at, assignment.replicates) for assignment in generation.assignments
            )
            generations.append(Generation(number, assignments, generation.reason))
        return Proposed(tuple(generations), record.ended)

    def keep(self, number: int, proposal: Proposal) -> Proposed:
        """Write a proposal, unless another process has written one, and return the proposals that the file has then.

        Raises LabError, OSError.
        """
        with self._lab.alone(f"campaign-{self.path.stem}"):
            before = self.read()  # under the lock: another process may have written a proposal since
            after = with_proposal(before, number, proposal)
            if after != before:
                make_folder(self.path.parent)
                write_bytes(self.path, self._text(after))
            return after

    def _text(self, proposed: Proposed) -> bytes:
        generations = [
            {
                "reason": generation.reason,
                # without `discharges`: strategies of studies leave these to `discharges_per_bed`
                "assignments": [
                    {"at": dict(assignment.at), "replicates": assignment.replicates}
                    for assignment in generation.assignments
                ],
            }
            for generation in proposed.generations
        ]
        record = _Record.model_validate({**self._head, "generations": generations, "ended": proposed.ended})
        return record.model_dump_json(indent=1).encode() + b"\n"


def campaign_of(study: Study, lab: LabFolder, backend: str, writes: bool = False) -> Campaign | None:
    """Take up the campaign of a study in a lab, as far as it has come.

    Args:
        study: As its author stated it.
        lab: Has what was proposed before.
        backend: Name of the backend whose runs are looked at.
        writes: Keep what is proposed from here on.

    Returns:
        The campaign; None for a study that names no strategy.

    Raises:
        LabError: What was proposed before cannot be read.
    """
    if study.adapt is None:
        return None
    file = CampaignFile(lab, study, study.adapt, backend)
    return Campaign(study.adapt, study, file.read(), file.keep if writes else None)


def as_proposed(study: Study, lab: LabFolder, backend: str) -> tuple[Study, tuple[str, ...]]:
    """Give a study the points that its strategy has proposed in a lab so far, with the reasons, line by line.

    A study without a strategy, or one for which nothing was proposed yet, is given back as it is. Raises LabError.
    """
    campaign = campaign_of(study, lab, backend)
    if campaign is None or not campaign.assignments:
        return study, ()
    return with_points(study, campaign.assignments), tuple(campaign.lines)
