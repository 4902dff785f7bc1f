"""Which runs count for a tool, as a part of a query on the table of runs."""

from dataclasses import dataclass


@dataclass(frozen=True)
class ToolOf:
    """Runs that had the tool ``name`` on the flange; None: all runs.

    ``unnamed``: those that note none, as all did once, count as well.
    """

    name: str | None = None
    unnamed: bool = False

    @property
    def sql(self) -> str:
        return "(? IS NULL OR tool = ? OR (? AND tool IS NULL))"

    @property
    def values(self) -> tuple[str | None, str | None, bool]:
        return self.name, self.name, self.unnamed


ANY_TOOL = ToolOf()
