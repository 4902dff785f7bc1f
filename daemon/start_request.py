"""What somebody asks for who starts a job."""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class StartRequest:
    """A job or a recipe by its name, with ``params`` over its config section.

    ``who`` asks, over ``channel`` (as ``control`` or ``modbus``), from the address ``client`` where the
    channel has addresses. ``dry_run`` lists the plan and moves nothing; ``adopt`` is the number of an
    earlier run whose finished poses are taken over.
    """

    job: str
    params: Mapping[str, str]
    who: str
    channel: str
    dry_run: bool = False
    adopt: int | None = None
    recipe: str = ""  # the name of what is started where it is one; ``job`` is then its job
    client: str = ""
