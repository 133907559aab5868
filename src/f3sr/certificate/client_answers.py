"""What clients answer, checked before it is believed: a client is another program in another environment."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from f3sr.errors import InputError
from f3sr.files import limited_file, strict_json
from f3sr.files.bounds import MAX_OBJECTS

ANSWER = "answer.json"
MAX_ANSWER_BYTES = 100_000_000
"""Largest answer: a thousand objects have about 15 MB of samples."""
MAX_FINDINGS = 10_000
STRICT = ConfigDict(strict=True, allow_inf_nan=False, extra="forbid", frozen=True)
Text = Annotated[str, Field(max_length=2000)]
Number = float | None
"""None is what was not finite."""
Versions = Annotated[dict[Text, Text], Field(max_length=20)]
State = tuple[Number, Number, Number, Number, Number, Number, Number]
"""Position [m] and quaternion (w, x, y, z)."""


class Missing(BaseModel):
    """The answer of a client without its library."""

    model_config = STRICT
    missing: Text


class BodyTold(BaseModel):
    """An object as the engine has it: mass [kg], centre (3,) [m], inertia (3, 3) [kg m2] in the object frame."""

    model_config = STRICT
    mass: Number
    center: tuple[Number, Number, Number]
    inertia: tuple[tuple[Number, Number, Number], tuple[Number, Number, Number], tuple[Number, Number, Number]]


class ReleaseAnswer(BaseModel):
    """What an engine did with a package."""

    model_config = STRICT
    versions: Versions
    settings: Text
    timestep: Annotated[float, Field(gt=0)]
    bodies: dict[Text, BodyTold]
    samples: Annotated[tuple[dict[Text, State], ...], Field(max_length=100_000)]
    penetrations: dict[Text, Number] | None
    notes: Annotated[tuple[Text, ...], Field(max_length=20)]

    def fault(self, names: Collection[str], moving: Collection[str], samples: int) -> str:
        """What is wrong with it for a package of these objects, of which some are moving; empty where nothing is."""
        if len(self.samples) != samples:
            return f"{len(self.samples)} samples, not {samples}"
        for what, told, wanted in (
            *(("a sample", s, names) for s in self.samples),
            ("bodies", self.bodies, moving),
            ("penetrations", names if self.penetrations is None else self.penetrations, names),
        ):
            if missing := sorted(set(wanted) - set(told)):
                return f"{what} without {missing[0]}"
            if foreign := sorted(set(told) - set(names)):
                return f"{what} with {foreign[0]!r:.60}, which the package has not"
        return ""


class Finding(BaseModel):
    """Something that a validator says of a file."""

    model_config = STRICT
    severity: Literal["error", "warning", "note"]
    file: Text
    text: Text


class FindingsAnswer(BaseModel):
    """What a validator found."""

    model_config = STRICT
    versions: Versions
    findings: Annotated[tuple[Finding, ...], Field(max_length=MAX_FINDINGS)]
    checked: Annotated[int, Field(ge=0, le=MAX_OBJECTS + 1)]
    """Files that it looked at."""


def read_answer(
    job: Path, kind: type[ReleaseAnswer] | type[FindingsAnswer]
) -> ReleaseAnswer | FindingsAnswer | Missing:
    """The answer in a job folder. Raises InputError naming the file."""
    file = job / ANSWER
    accepted = "the answer of a client"
    data = limited_file.read(file, most=MAX_ANSWER_BYTES, accepted=accepted)
    try:
        tree = strict_json.loads(data)
    except ValueError as error:
        raise InputError(file, found=f"no valid JSON ({error})", accepted=accepted) from error
    model = Missing if isinstance(tree, dict) and "missing" in tree else kind
    try:
        return model.model_validate_json(data)
    except ValidationError as error:
        found, accepted = strict_json.problem(error, ", ".join(model.model_fields))
        raise InputError(file, found=found, accepted=accepted) from None
