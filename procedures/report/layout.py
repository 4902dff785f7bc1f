"""What the report of one kind of result is made of; a kind plugs in with one :class:`Layout`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic

from procedures.report.cover import Cover
from procedures.report.html import Html
from procedures.report.source import S

Section = Callable[[S], Html | None]


@dataclass(frozen=True)
class Page(Generic[S]):
    """Sections in reading order: ``top``, then ``left`` beside ``right``, then ``rest`` below each other.

    A section that has nothing to say about a result returns None.
    """

    top: tuple[Section[S], ...]
    left: tuple[Section[S], ...]
    right: tuple[Section[S], ...]
    rest: tuple[Section[S], ...]


@dataclass(frozen=True)
class Layout(Generic[S]):
    """``source`` reads what the sections ask for; its data set is ``data_file`` in a run folder.

    ``cover`` is what the first page says beside what all reports say there.
    ``shows_truth``: a section puts the result beside the truth of a twin, where that is known.
    """

    source: type[S]
    data_file: str
    title: Callable[[S], str]
    page: Callable[[S], Page[S]]
    cover: Callable[[S], Cover] = lambda _source: Cover()
    shows_truth: bool = False
