"""What an integrator can set for a touch test."""

from typing import Annotated, Self

from pydantic import Field, field_validator, model_validator

from cell.formats.reading import Strict

LEAST_WAY_DOWN_M = 0.005  # guarded by the force, from clear_m to stand_off_m


class TouchTestConfig(Strict):
    """``[job.touch-test]``: the board lies in the cell, and the camera is on the flange."""

    target: str = Field(description="name of a [target.NAME] section")
    look_pose: str = Field(
        description="name of a [poses] entry from which the camera sees the whole board, about as far "
        "from it as the hand-eye's capture was"
    )
    corners: list[Annotated[int, Field(ge=0)]] | None = Field(
        default=None,
        min_length=4,
        max_length=20,
        description="numbers of the target's points, from 0, four or more, each once; else its four "
        "outermost that the look shows",
    )
    stand_off_m: float = Field(
        default=0.003,
        ge=0.0005,
        le=0.05,
        description="the tool's point above the board; the thickness of the gauge that is held between",
    )
    clear_m: float = Field(
        default=0.05,
        gt=0.005,
        le=0.5,
        description="above the board, on the way from corner to corner; at least 5 mm more than stand_off_m",
    )
    speed_m_s: float = Field(default=0.02, gt=0, le=0.25, description="down to a corner and up again")
    max_force_n: float = Field(
        default=20.0,
        gt=0,
        le=500.0,
        description="force that ends the way down to a corner; a person is asked then",
    )
    stand_sigma_m: float = Field(
        default=2e-4,
        gt=0,
        le=0.01,
        description="how well a person brings the tool's point over a corner at the gauge's height, per axis",
    )
    tool_sigma_m: float = Field(
        default=1e-4,
        ge=0,
        le=0.01,
        description="how well the tool's point on the flange is known, per axis; it is common to all corners",
    )
    max_jog_m: float = Field(
        default=0.02,
        gt=0,
        le=0.2,
        description="a point that stands further from where the camera has its corner is asked for again",
    )
    frames: int = Field(
        default=5, ge=1, le=50, description="pictures of the look, whose corners are averaged"
    )
    settle_s: float = Field(default=0.3, ge=0.0, le=10.0, description="wait at rest before they are taken")
    max_duration_s: float = Field(
        default=3600.0, gt=0, description="the run is ended when it takes longer, s"
    )

    @field_validator("corners")
    @classmethod
    def _each_once(cls, corners: list[int] | None) -> list[int] | None:
        if corners is not None and len(set(corners)) < len(corners):
            raise ValueError("a point is named twice; name each once")
        return corners

    @model_validator(mode="after")
    def _comes_down(self) -> Self:
        if round(self.clear_m - self.stand_off_m - LEAST_WAY_DOWN_M, 6) < 0.0:
            raise ValueError(
                f"clear_m = {self.clear_m:g} should be at least {LEAST_WAY_DOWN_M:g} larger than "
                f"stand_off_m = {self.stand_off_m:g}, for a way down that a force can end; raise clear_m, or "
                "lower stand_off_m"
            )
        return self
