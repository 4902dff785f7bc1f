"""What a run of picking came to, as ``cellward.result/1``."""

from cell.formats.result import Empty, Warning_
from cell.run_values import RunValues
from procedures.belt.config import BeltTrackingConfig
from procedures.belt.contact_uncertainty import CALIBRATE, NOT_CALIBRATED, shares
from procedures.belt.encoder_alarms import emergency_warnings
from procedures.belt.item_tracking import LOOK_BACK_S, BeltWatch
from procedures.belt.items import Outcome
from procedures.belt.motion.arm_following import ArmFollowing
from procedures.belt.motion.gripper_times import GripperTimes
from procedures.belt.motion.place_clear import PlaceWaits
from procedures.belt.motion.places import Places
from procedures.belt.result import (
    BeltTrackingResult,
    CameraStalls,
    GridFill,
    PickingAnswer,
    PickingInputs,
    PlaceWaitTimes,
    Slip,
)
from procedures.belt.stamp_delays import StampDelays
from procedures.words import mm

_NOMINAL = f"the belt is not calibrated: {NOT_CALIBRATED} counts in contact_95_m; {CALIBRATE} measures both"


def result_of(
    watch: BeltWatch,
    following: ArmFollowing,
    gripper_times: GripperTimes,
    waits: PlaceWaits,
    places: Places,
    config: BeltTrackingConfig,
    values: RunValues,
    duration_s: float,
) -> BeltTrackingResult:
    """Counters, rates and what items were lost to. The verdict warns when items were missed."""
    counts = watch.queue.counts
    picks = counts[Outcome.PICKED]
    misses = {o.value: counts[o] for o in Outcome if o is not Outcome.PICKED and counts[o]}
    tried = picks + counts[Outcome.GRIP_FAILED] + counts[Outcome.LOST]
    warnings = [
        Warning_(code=f"belt.{cause.replace(' ', '-')}", text=f"{n} missed: {cause}")
        for cause, n in misses.items()
    ]
    if watch.slips:
        most = 1e3 * max(abs(slip.by) for slip in watch.slips)
        text = f"the encoder's wheel slipped {len(watch.slips)} times, by {most:.1f} mm at most"
        warnings.append(Warning_(code="belt.slip", text=text))
    if jumps := watch.origin.jumps:
        most = 1e3 * max(abs(jump) for jump in jumps)
        text = f"the encoder's position jumped {len(jumps)} times, by {most:.0f} mm at most"
        warnings.append(Warning_(code="belt.jump", text=text))
    if (stall := watch.stall).count:
        text = f"the camera gave no picture {stall.count} times, for {stall.longest_s:.1f} s at most"
        warnings.append(Warning_(code="belt.camera-stall", text=text))
    if watch.late:
        text = f"{watch.late} pictures came more than {LOOK_BACK_S:g} s after exposure and were not used"
        warnings.append(Warning_(code="belt.late-pictures", text=text))
    off_m = following.contacts.largest_m or 0.0
    if off_m > config.following_limit_m:
        text = f"an item was {1e3 * off_m:.1f} mm beside the tool at contact, as later counts show"
        warnings.append(Warning_(code="belt.contact-off", text=text))
    if (left_behind := following.left_behind) is not None:
        warnings.append(Warning_(code="belt.following", text=left_behind))
    stated = following.contacts.together
    if stated is not None and stated.r95_m > config.following_limit_m:
        text = (
            f"contacts may be off by {mm(stated.r95_m)} (95 %), mostly by {next(iter(shares(stated)))}; "
            f"following_limit_m is {mm(config.following_limit_m)}"
        )
        warnings.append(Warning_(code="belt.contact-95", text=text))
    if (tight := gripper_times.tight) is not None:
        warnings.append(Warning_(code="belt.grip-timeout", text=tight))
    if picks and not gripper_times.confirmed:
        text = (
            f"nothing confirms what the gripper holds: {picks} picks are grips whose time was over, and any "
            "may be empty; wire a vacuum switch or a sensor in the fingers, and give it as confirm"
        )
        warnings.append(Warning_(code="belt.unconfirmed", text=text))
    warnings += emergency_warnings(watch.emergencies.told)
    if not any(name.startswith("belt.") for name in values.versions):
        warnings.append(Warning_(code="belt.nominal", text=_NOMINAL))
    budget = following.contacts.budget
    delays = StampDelays(values.time_offset_s) if budget is None else budget.delays
    warnings += delays.warnings()
    camera = None if watch.record is None else watch.record.camera
    if camera is not None and camera["lens"] is None:
        text = (
            "items were placed with the lens that the camera tells: the calibration of its pose has none of"
        )
        warnings.append(Warning_(code="belt.lens", text=f"{text} such pictures; run cone-capture"))
    return BeltTrackingResult(
        verdict="warn" if warnings else "pass",
        reasons=[f"{n} missed: {cause}" for cause, n in misses.items()],
        warnings=warnings,
        result=PickingAnswer(
            picks=picks,
            misses=misses,
            seen=watch.queue.seen,
            success=picks / tried if tried else None,
            duration_s=duration_s,
            picks_per_minute=60.0 * picks / duration_s if duration_s > 0 else None,
            counters=watch.queue.live(),
            slips=[Slip(t=slip.t, along_m=slip.by, sigma_m=slip.sigma) for slip in watch.slips],
            jumps_m=list(watch.origin.jumps),
            camera_stalls=CameraStalls(count=stall.count, longest_s=stall.longest_s),
            place_waits=PlaceWaitTimes(count=waits.count, longest_s=waits.longest_s, total_s=waits.total_s),
            grid=GridFill(
                places=len(places), filled=places.filled, next=places.number, renewed=places.renewed
            )
            if places.is_grid
            else None,
            arm_lag_s=following.lag.s if following.looks else None,
            following_rms_m=following.rms_m,
            following_largest_m=following.largest_m if following.looks else None,
            contact_off_rms_m=following.contacts.rms_m,
            contact_off_largest_m=following.contacts.largest_m,
            camera_delay_95_s=delays.camera_95_s,
            contact_95_m=None if stated is None else stated.r95_m,
            contact_95_largest_m=following.contacts.largest_95_m,
            contact_95_shares=None if stated is None else shares(stated),
            contact_95_assumed=following.contacts.assumed,
            contact_95_without=following.contacts.not_covered,
            gripper_closing_s=gripper_times.closing_s,
            gripper_opening_s=gripper_times.opening_s,
            follow=config.follow,
            method=config.method,
        ),
        uncertainty=Empty(),
        residuals=Empty(),
        heldout=Empty(),
        observability=Empty(),
        inputs=PickingInputs(
            belt=None if values.belt is None else dict(values.belt), versions=dict(values.versions)
        ),
    )
