"""Why ways across a beam cannot be used, by the name of the error that comes of it when it persists."""

from dataclasses import dataclass

import numpy as np

from cell.errors import CellError, error
from procedures.laser.config import SearchSection
from procedures.laser.sweep import BeamPass


@dataclass(frozen=True)
class PassFault:
    """``name`` is that of the catalogue."""

    name: str
    text: str

    def error(self, attempts: int) -> CellError:
        return error(self.name, f"{self.text}, in {attempts} attempts")


def gap_of(ways: tuple[BeamPass, ...], search: SearchSection) -> PassFault | None:
    """Why the ways may have missed an edge, or None."""
    for way in ways:
        limit, text = search.max_poll_gap_s, ""
        if way.restarted:
            text = "the input module or the arm was connected anew on a way"
        elif way.poll_gap_s > limit:
            text = f"no poll of the inputs for {1e3 * way.poll_gap_s:.0f} ms"
        elif way.blind_s > limit:
            text = f"no poll of the inputs in {1e3 * way.blind_s:.0f} ms at an end of the way"
        elif way.state_gap_s > limit:
            text = f"no state of the arm for {1e3 * way.state_gap_s:.0f} ms"
        if text:
            return PassFault("LASER_POLL_GAP", f"beam {way.beam.name}: {text}")
    return None


def stuck_dark(out: BeamPass, back: BeamPass) -> PassFault | None:
    """A beam that is broken where the tool is clear of it, or None."""
    if out.begins_dark or back.ends_dark:
        when = "before" if out.begins_dark else "after"
        return PassFault(
            "LASER_BEAM_DARK", f"beam {out.beam.name} is broken {when} the sweep, with the tool beside it"
        )
    return None


def one_sided(out: BeamPass, back: BeamPass) -> PassFault | None:
    """A beam that showed the tool on one way only, or None."""
    if out.triggered == back.triggered:
        return None
    seen, missed = ("out", "back") if out.triggered else ("back", "out")
    return PassFault(
        "LASER_RETURN_LOST", f"beam {out.beam.name} switched on the way {seen} and not on the way {missed}"
    )


def crossing_fault(out: BeamPass, back: BeamPass, search: SearchSection) -> PassFault | None:
    """Why a pair does not show the tool crossing, or None; gaps come first, as they explain the rest."""
    fault = gap_of((out, back), search) or stuck_dark(out, back) or one_sided(out, back)
    if fault is not None:
        return fault
    for way in (out, back):
        if (found := len(way.edges())) != search.edges:
            return PassFault(
                "LASER_EDGES", f"beam {way.beam.name} switched {found} times, not {search.edges}"
            )
    return None


def fault_of(out: BeamPass, back: BeamPass, search: SearchSection) -> PassFault | None:
    """Why a pair cannot be measured with, or None."""
    if (fault := crossing_fault(out, back, search)) is not None:
        return fault
    limit = search.max_speed_deviation
    for way in (out, back):
        if (deviation := way.speed_deviation()) > limit:
            text = f"the speed at the edges of beam {way.beam.name} differs by {100 * deviation:.1f} %"
            return PassFault("LASER_SPEED", f"{text}, the limit is {100 * limit:g} %")
    apart = float(np.mean(out.edge_positions()) - np.mean(back.edge_positions()))
    if abs(apart) > search.max_out_back_m:
        text = f"beam {out.beam.name}: out and back disagree by {1e3 * apart:.3f} mm"
        return PassFault("LASER_OUT_BACK", f"{text}, the limit is {1e3 * search.max_out_back_m:g} mm")
    return None
