"""The jobs of crossed beams on a twin: two beams on the way that the reference gives the tool."""

from pydantic import BaseModel

from cell.known_cell import KnownBeam, KnownBeams
from procedures.laser.config import BEAMS, BeamSection, LaserReferenceConfig, LaserUpdateConfig
from procedures.rehearsal import Rehearsal, cannot, joints, needed
from procedures.setup import Setup

REFERENCE = "laser-reference"
_COUNTING = ("ioLogik-E1210", "ADAM-6050")  # modules whose counters have a known place


def rehearse_reference(setup: Setup, job: LaserReferenceConfig) -> Rehearsal:
    """``CONFIG_INVALID`` says what the configuration lacks."""
    needed(setup, "arm", "beams")
    radius = job.pin_radius_m or float(setup.values.tool["radius_m"])
    beams = {beam.input: _beam(setup, beam, i) for i, beam in enumerate(getattr(job, n) for n in BEAMS)}
    module = setup.devices[setup.roles["beams"]]
    known = KnownBeams(
        beams,
        radius,
        job.descend_step_m * job.max_descents,
        filter_s=getattr(module, "filter_s", None),
        counters=_counts(module),
    )
    return Rehearsal(joints(setup, job.xs.aux)[0], beams=known)


def rehearse_measurement(setup: Setup, job: BaseModel) -> Rehearsal:
    """A check of an unmoved tool, an update of one that was hit, or a delay: each after the reference."""
    reference = setup.job(LaserReferenceConfig)
    if reference is None:
        raise cannot(f"there is no [job.{REFERENCE}], whose beams the job crosses; add it")
    found = rehearse_reference(setup, reference)
    bumped = isinstance(job, LaserUpdateConfig)
    return Rehearsal(found.look, beams=found.beams, before=(REFERENCE,), bumps_tool=bumped)


def _counts(module: BaseModel) -> bool:
    """Whether the module's counters are read, as its section says."""
    if not getattr(module, "use_counters", False):
        return False
    return getattr(module, "module", "") in _COUNTING or getattr(module, "counters", None) is not None


def _beam(setup: Setup, beam: BeamSection, number: int) -> KnownBeam:
    inputs = getattr(setup.devices[setup.roles["beams"]], "inputs", {})
    channel = getattr(inputs.get(beam.input), "address", number)
    return KnownBeam(
        channel=int(channel),
        q_aux=joints(setup, beam.aux)[1],
        across=[float(v) for v in beam.across_unit],
        distance_m=beam.distance_m,
        along_m=beam.along_m,
    )
