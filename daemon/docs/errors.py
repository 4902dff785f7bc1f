"""``docs/errors.md``: every error by its number."""

from cell.errors import Reaction, catalogue
from daemon.docs.page import cell, page

KINDS = {
    1: "Communication",
    2: "Device and machine",
    3: "Motion and safety state",
    4: "Input and configuration",
    5: "Measurement and solving",
    6: "Request refused",
    9: "Internal",
}
REACTIONS = {
    Reaction.RETRY: "the daemon reconnects by itself; a job that used it ends",
    Reaction.ABORT: "the job ends",
    Reaction.LATCH: "the job ends, and nothing moves before an operator resets",
    Reaction.INPUT: "the person at the keyboard has to change something",
    Reaction.REFUSE: "nothing happened",
    Reaction.INTERNAL: "a defect, or an end without a request: keep the run folder and the log",
}
HEAD = """
# Errors

Source: `cell/catalogue.toml`. `cellward explain CODE` prints one of them. The reaction is what the daemon
does.
"""


def errors_page() -> str:
    """The text of ``docs/errors.md``."""
    lines = ["| reaction | what happens |", "|---|---|"]
    lines += [f"| {reaction} | {text} |" for reaction, text in REACTIONS.items()]
    entries = sorted(catalogue().values(), key=lambda entry: entry.code)
    for kind, title in KINDS.items():
        rows = [e for e in entries if e.code // 1000 == kind]
        lines += ["", f"## {kind}xxx {title}", "", "| code | name | reaction | text | what to do |"]
        lines.append("|---|---|---|---|---|")
        lines += [f"| {e.code} | `{e.name}` | {e.reaction} | {cell(e.text)} | {cell(e.hint)} |" for e in rows]
    return page(HEAD, lines)
