"""The first page: the verdict with its reasons, and the answer with its uncertainty."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.report.html import Html, absent, bullets, el, note, paragraph, section, table
from procedures.report.numbers import DASH, K95, covariance, deg, degs, dig, mm, mms, number, radius95
from procedures.report.source import Source

_HEADLINE = {
    "pass": "Pass",
    "warn": "Pass with warnings",
    "fail": "Fail",
}
_REMEDY = {
    "too-few-poses": "Take more poses. Three usable ones are the least; 15 to 20 at each placement are good.",
    "poses-not-distinct": "The recorded flange poses are equal. Check that the arm moved between the images "
    "and that the pose was read at each image.",
    "no-rotation": "Turn the flange between poses, about two axes or more, by 15 degrees or more; shifts "
    "alone say nothing about where the camera sits.",
    "parallel-axes": "Add poses that turn the flange about another axis, at right angles to the one used.",
    "rigid-roll": "Keep the camera's roll constant while it goes round the target, or add poses that tilt it "
    "about other axes. A camera that turns with its generatrix cannot be calibrated by any solver.",
}


def verdict_section(source: Source) -> Html:
    """The verdict, why, and four figures to take away."""
    result = source.result
    verdict = str(result.get("verdict"))
    refused = source.answer is None
    headline = "Refused: the data cannot determine the answer" if refused else _HEADLINE.get(verdict, verdict)
    unfinished = dig(source.end, "outcome") not in (None, "complete")
    if unfinished:
        headline += f" (but the run ended {dig(source.end, 'outcome')})"
    warnings = [w for w in result.get("warnings") or [] if isinstance(w, Mapping)]
    told = {w.get("text") for w in warnings}
    reasons = [r for r in result.get("reasons") or [] if r not in told]
    body: list[object] = []
    if reasons:
        body.append(bullets(reasons))
    if refused:
        body.append(paragraph(el("b", "What to do. "), _remedy(source)))
    if warnings:
        body.append(bullets(el("span", el("code", w.get("code")), " ", w.get("text")) for w in warnings))
    if not body:
        body.append(paragraph("No finding: the data determine the answer and nothing is to be warned of."))
    kind = verdict if verdict in _HEADLINE else "fail"
    if unfinished and kind == "pass":
        kind = "warn"
    banner = el("div", el("h2", headline), *body, class_=f"verdict {kind}")
    return banner if refused else Html(banner + _cards(source))


def _remedy(source: Source) -> str:
    name = dig(source.result, "observability", "refused")
    if name is None:
        name = next(iter(source.result.get("reasons") or [""])).split(":")[0]
    return _REMEDY.get(str(name), "Mend what the reason names, take the poses again, and solve again.")


def _cards(source: Source) -> Html:
    cov = covariance(dig(source.answer, "cov"))
    t95, r95 = (DASH, DASH) if cov is None else (mm(radius95(cov[:3, :3])), deg(radius95(cov[3:, 3:])))
    held = dig(source.result, "heldout", "rms")
    used, total = (dig(source.result, "inputs", key) for key in ("used", "observations"))
    return el(
        "div",
        _card(t95, "95 % of position errors of the camera are below this, if the model holds"),
        _card(r95, "95 % of its rotation errors are below this, if the model holds"),
        _card(
            f"{mm(dig(held, 't'))}, {deg(dig(held, 'r'))}",
            "held-out check: target's pose by poses that the solution did not see, RMS",
        ),
        _card(
            f"{_or_dash(used)} of {_or_dash(total)}", "observations used; each one left out has its reason"
        ),
        class_="cards",
    )


def _card(value: str, meaning: str) -> Html:
    return el("div", el("b", value), el("span", meaning), class_="card")


def _or_dash(value: Any) -> str:
    return DASH if value is None else str(value)


def result_section(source: Source) -> Html:
    """X in millimetres and degrees, with 95 % intervals along the axes of the frame it is given in."""
    X, parent = source.X, source.parent
    title = f"The result: camera in {parent}"
    if X is None:
        return section(title, absent("There is no answer, so there is no pose to show."))
    rotation = Rotation.from_matrix(X[:3, :3])
    cov = covariance(dig(source.answer, "cov"))
    rows: list[list[object]] = [["position, mm", *mms(X[:3, 3])]]
    if cov is not None:
        turned = X[:3, :3] @ cov[:3, :3] @ X[:3, :3].T
        rows.append(["± 95 %, mm", *mms(K95 * np.sqrt(np.diag(turned)))])
    rows.append(["rotation vector, °", *degs(rotation.as_rotvec())])
    if cov is not None:
        turned = X[:3, :3] @ cov[3:, 3:] @ X[:3, :3].T
        rows.append(
            [
                f"± 95 % about the axes of the {parent}, °",
                *degs(K95 * np.sqrt(np.diag(turned))),
            ]
        )
    quaternion = ", ".join(f"{v:.6f}" for v in rotation.as_quat())
    raw = ", ".join(f"{number(v) or 0.0:.9g}" for v in dig(source.answer, source.name))
    return section(
        title,
        table((el("code", source.name), "x", "y", "z"), rows, "lrrr"),
        note(
            f"The pose of the camera (x right, y down, z forward) in the {parent}: it maps points in the "
            f"camera to points in the {parent}. The intervals come from the covariance of the solution "
            "(1.96 standard deviations); they hold if the noise is as estimated and the arm and the lens "
            "follow their models. Intervals are not residuals."
            if cov is not None
            else "This method gave no covariance for these data, so no interval can be stated."
        ),
        note("As in files (m, rad): ", el("code", f"[{raw}]")),
        note("Quaternion x, y, z, w: ", el("code", quaternion)),
    )
