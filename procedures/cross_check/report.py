"""The report of a cross check: what has changed, how probable it is, and what to do."""

from procedures.cross_check.result import CrossCheckResult
from procedures.cross_check.solver import FILE_NAME
from procedures.cross_check.words import NAMES, WHAT_TO_DO, said
from procedures.report.html import Html, bullets, el, note, section, table
from procedures.report.layout import Layout, Page
from procedures.report.origin import inputs_section
from procedures.report.source import Source
from procedures.report.verdict import banner

_REMEDY = {part.replace(" ", "-"): what for part, what in WHAT_TO_DO.items()}


def verdict_section(source: Source[CrossCheckResult]) -> Html:
    """The verdict and what to do."""
    return banner(source, _REMEDY, "Correct what the reason names, and take the capture again.")


def explanations_section(source: Source[CrossCheckResult]) -> Html | None:
    """Each explanation and how probable it is."""
    if source.found is None:
        return None
    found = source.found
    rows = [(NAMES[name], f"{100 * share:.1f} %") for name, share in found.result.probable.items()]
    still_open = found.observability.undetermined
    rest = (el("h3", "Not told"), bullets(still_open)) if still_open else ()
    return section(
        said(found.result).partition(": ")[2].capitalize(),
        table(("explanation", "probable"), rows, "lr"),
        note(found.uncertainty.meaning),
        *rest,
    )


def _page(_source: Source[CrossCheckResult]) -> Page[Source[CrossCheckResult]]:
    return Page(top=(verdict_section, explanations_section), left=(), right=(), rest=(inputs_section,))


CROSS_CHECK = Layout(
    source=Source, data_file=FILE_NAME, title=lambda _source: "Cross check of the cell", page=_page
)
