"""Why data cannot determine an answer."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Refusal:
    """A fixed ``name``, and in ``words`` what is missing or the direction that is not observable."""

    name: str
    words: str

    def __str__(self) -> str:
        return f"{self.name}: {self.words}"
