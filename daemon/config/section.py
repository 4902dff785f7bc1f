"""What every section of ``cell.toml`` is."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Pose6 = Annotated[list[float], Field(min_length=6, max_length=6)]
Point = Annotated[list[float], Field(min_length=3, max_length=3)]


class Section(BaseModel):
    """Unknown keys are errors; values are never guessed from another type."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def absolute(value: str) -> str:
    """A path that does not depend on where the program was started."""
    if not value.startswith("/"):
        raise ValueError("an absolute path was expected")
    return value
