"""What every section of ``cell.toml`` is."""

from typing import Annotated, Any, ClassVar

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, model_serializer

Pose6 = Annotated[list[float], Field(min_length=6, max_length=6)]
Point = Annotated[list[float], Field(min_length=3, max_length=3)]


class Section(BaseModel):
    """Unknown keys are errors; values are never guessed from another type."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class GrownSection(Section):
    """A section that got optional keys later. It is dumped without those that nobody set, so that the digest
    of a file that lacks them stays what it was, and a run of before can be taken up."""

    LATER: ClassVar[frozenset[str]] = frozenset()

    @model_serializer(mode="wrap")
    def _without_unset(self, dumped: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {
            key: value for key, value in dumped(self).items() if value is not None or key not in self.LATER
        }


def absolute(value: str) -> str:
    """A path that does not depend on where the program was started."""
    if not value.startswith("/"):
        raise ValueError("an absolute path was expected")
    return value
