"""Whether the passes of a comparison show enough; refusals say what most passes were left out for."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from calibration.tool_frame.crossings import Crossing, PassContents
from calibration.tool_frame.geometry import BEAMS
from calibration.tool_frame.scene import Refused, ToolFrameScene
from calibration.tool_frame.selection import Selection, select


def selected(scene: ToolFrameScene, seen: PassContents) -> tuple[Selection, list[tuple[str, str]]]:
    """The passes to be used, with warnings; refused where a set does not show the tool in both beams."""
    if not seen.crossings:
        what = "no pass shows the tool breaking a beam and clearing it again"
        raise Refused("no-edges", what + _mostly(seen.reasons.values()))
    for current, words in ((False, "reference"), (True, "current")):
        beams = {c.source.beam for c in seen.crossings.values() if c.source.current == current}
        if not beams:
            why = [r for k, r in seen.reasons.items() if scene.passes[k].current == current]
            what = f"no {words} pass shows the tool breaking a beam and clearing it"
            raise Refused("no-edges", what + _mostly(why))
        if len(beams) < len(BEAMS):
            lost = next(b for b in BEAMS if b not in beams)
            raise Refused(
                "one-beam-only",
                f"the {words} passes show the tool in beam {next(iter(beams))} alone; its place "
                f"across beam {lost} is not seen",
            )
    selection = select(scene, seen)
    across = list(selection.across)
    warnings = []
    for current in (False, True):
        for beam in BEAMS:
            if _own(scene, across, beam, current):
                continue
            grazing = _own(scene, selection.grazing, beam, current)
            if grazing:
                across += grazing
                warnings.append(
                    ("laser.grazing", f"beam {beam} was crossed at the tool's very end alone; go deeper")
                )
    if len(across) != len(selection.across):
        reasons = {k: r for k, r in selection.reasons.items() if k not in across}
        selection = Selection(sorted(across), selection.grazing, selection.hits, selection.missed, reasons)
    return selection, warnings


def _own(scene: ToolFrameScene, places: Sequence[int], beam: str, current: bool) -> list[int]:
    passes = scene.passes
    return [k for k in places if passes[k].beam == beam and passes[k].current == current]


def check_enough(
    scene: ToolFrameScene, crossings: Mapping[int, Crossing], reasons: Mapping[int, str]
) -> None:
    """Refuse ``crossings`` that leave a set without a beam; ``reasons`` say why the others are out."""
    for current, words in ((False, "reference"), (True, "current")):
        for beam in BEAMS:
            if not _own(scene, list(crossings), beam, current):
                why = [reasons[k] for k in _own(scene, list(reasons), beam, current)]
                raise Refused(
                    "too-few-passes",
                    f"no {words} pass across beam {beam} can be used; its place there is not determined"
                    + _mostly(why),
                )


def _mostly(reasons: Iterable[str]) -> str:
    """The commonest reason for which passes were left out, to end a refusal with; empty without any."""
    found = Counter(reasons).most_common(1)
    return "".join(f"; {count} were left out because: {reason}" for reason, count in found)
