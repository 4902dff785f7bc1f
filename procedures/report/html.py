"""HTML that is escaped by construction: plain text is escaped, only :class:`Html` passes as it is."""

from collections.abc import Iterable, Sequence
from html import escape
from importlib.resources import files


class Html(str):
    """Text that is markup already."""

    __slots__ = ()


def text(value: object) -> Html:
    """``value`` as markup: itself if it is :class:`Html`, else escaped."""
    return value if isinstance(value, Html) else Html(escape(str(value)))


def el(name: str, *children: object, **attributes: str) -> Html:
    """One element; ``class_`` stands for the attribute ``class``, ``aria_hidden`` for ``aria-hidden``."""
    attrs = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(value)}"' for key, value in attributes.items()
    )
    return Html(f"<{name}{attrs}>{join(children)}</{name}>")


def join(children: Iterable[object]) -> Html:
    """The markup of all ``children`` in a row; None is nothing."""
    return Html("".join(text(child) for child in children if child is not None))


def paragraph(*children: object) -> Html:
    return el("p", *children)


def note(*children: object) -> Html:
    """A remark in small print."""
    return el("p", *children, class_="note")


def absent(what: str) -> Html:
    """Says that a figure is not there, and why, instead of leaving a hole."""
    return el("p", what, class_="absent")


def bullets(items: Iterable[object]) -> Html:
    return el("ul", *(el("li", item) for item in items))


def table(head: Sequence[object], rows: Iterable[Sequence[object]], align: str = "") -> Html:
    """``align`` has one letter a column: l, or r for numbers; l where it ends."""

    def cells(name: str, row: Sequence[object]) -> Html:
        padded = align.ljust(len(row), "l")
        return join(
            el(name, cell, **({"class_": "num"} if a == "r" else {}))
            for cell, a in zip(row, padded, strict=False)
        )

    header = el("thead", el("tr", cells("th", head))) if head else None
    body = el("tbody", *(el("tr", cells("td", row)) for row in rows))
    return el("div", el("table", header, body), class_="scroll")


def facts(rows: Iterable[tuple[str, object, str]]) -> Html:
    """Name, value and what the number means, side by side."""
    body = (
        el("tr", el("th", name), el("td", value, class_="value"), el("td", meaning, class_="meaning"))
        for name, value, meaning in rows
    )
    return el("div", el("table", el("tbody", *body), class_="facts"), class_="scroll")


def section(title: str, *children: object, name: str = "") -> Html:
    return el("section", el("h2", title), *children, class_=name)


def document(title: str, body: Html, script: str, reload_s: float | None = None, running: str = "") -> str:
    """The whole file. The policy in its head forbids every request, whatever the data try to insert.

    With ``reload_s`` a browser reads the file again that often. On paper ``running`` stands at the foot of
    every page, with its number.
    """
    reload = "" if reload_s is None else f'<meta http-equiv="refresh" content="{reload_s:g}">'
    own = files("procedures.report")
    style = own.joinpath("page.css").read_text("utf-8") + _foot(running)
    script += own.joinpath("print.js").read_text("utf-8") if script else ""
    policy = (
        "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">'
        f'<meta name="viewport" content="width=device-width, initial-scale=1">{reload}'
        f"<title>{escape(title)}</title><style>{style}</style><script>{script}</script></head>"
        f"<body><main>{body}</main></body></html>\n"
    )


def _foot(running: str) -> str:
    """The rule for the foot of a page; every character that means something to CSS or HTML is escaped."""
    text = "".join(c if (c.isascii() and c.isalnum()) or c == " " else f"\\{ord(c):x} " for c in running)
    return (
        f'@page {{ @bottom-left {{ content: "{text}"; font-size: 8pt; color: #5b6776; }} '
        '@bottom-right { content: counter(page) " / " counter(pages); font-size: 8pt; color: #5b6776; } }\n'
    )
