"""What ``cellward check`` expects of an eye-to-hand check, by the configuration alone."""

from typing import Any

from procedures.eye_to_hand.config import EyeToHandCheckConfig
from procedures.setup import Setup
from procedures.words import deg, mm


def eye_to_hand_expectation(setup: Setup, job: EyeToHandCheckConfig) -> dict[str, Any]:
    """``text``, what keeps the job from its answer, and what will be known less well than wished."""
    problems = setup.missing("arm", "fixed_camera") + setup.unseen(job.target, job.min_corners)
    cautions = []
    for what, sigma, limit, words in (
        ("place_sigma_t_m", job.place_sigma_t_m, job.accept.max_error_t_m, mm),
        ("place_sigma_r_rad", job.place_sigma_r_rad, job.accept.max_error_r_rad, deg),
    ):
        if 2.0 * sigma > limit:
            cautions.append(
                f"{what} is {words(sigma)}, and the hand-eye is to be judged to {words(limit)}: an error "
                "of the place is the same in all poses, so measure the place better or allow more"
            )
    text = (
        f"{job.poses} poses from {mm(job.nearest_m, 0)} to {mm(job.farthest_m, 0)} before the camera; the "
        f"target's place is known to {mm(job.place_sigma_t_m)} and {deg(job.place_sigma_r_rad)}, which no "
        "number of poses lowers"
    )
    return {"text": problems[0] if problems else text, "problems": problems, "cautions": cautions}
