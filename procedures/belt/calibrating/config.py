"""What an integrator can set for a belt calibration."""

from typing import Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from procedures.belt.config import ItemLook

_STRICT = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class Acceptance(BaseModel):
    """Limits on the result; within them it may be accepted without a person when ``auto`` is set."""

    model_config = _STRICT
    # Defaults that a sound cell meets: an OAK-D 0.8 m above the belt leaves 0.10 % (at most 0.15 %), 0.5 mrad
    # seen from above and 3.4 mrad (at most 4.7 mrad) of the rise, however many items pass.
    max_scale_share: float = Field(
        default=0.002,
        gt=0,
        le=0.1,
        description="half of the 95 % interval of m_per_count, as a share of it: 0.002 is 1.4 mm along the "
        "belt after 0.7 m",
    )
    max_dir_rad: float = Field(
        default=0.002,
        gt=0,
        le=0.1,
        description="half of the 95 % interval of dir seen from above, which puts contacts beside the item",
    )
    max_rise_rad: float = Field(
        default=0.007,
        gt=0,
        le=0.1,
        description="half of the 95 % interval of how dir rises, which has the tool too high or too low at "
        "the item: 7 mrad are 5 mm after 0.7 m",
    )
    max_heldout_m: float = Field(default=0.001, gt=0, le=0.1, description="RMS of sightings set aside")
    auto: bool = Field(default=False, description="accept a passing result without asking")


class BeltCalibrationConfig(BaseModel):
    """``[job.belt-calibration]``. Run the belt the way it runs in production: ``dir`` is that way."""

    model_config = _STRICT
    source: Literal["camera", "touch"] = Field(
        default="camera",
        description="camera: items are seen while the belt moves; touch: an operator jogs the tool's point "
        "to a mark on the belt, before and after the belt has moved",
    )
    belt_z_m: float | None = Field(
        default=None, ge=-5, le=5, description="camera: height of the belt's surface in the base"
    )
    camera_turn_95_rad: float = Field(
        default=0.0005,
        ge=0,
        le=0.05,
        description="camera: T_base_camera may be turned by so much (95 %), as its result says; so is dir",
    )
    distance_95_m: float = Field(
        default=0.0005,
        ge=0,
        le=0.05,
        description="camera: its distance from the belt, by T_base_camera and belt_z_m, may be off by so "
        "much (95 %); m_per_count is then in proportion",
    )
    items: ItemLook = Field(default_factory=ItemLook, description="how items look from the camera")
    sightings: int = Field(default=200, ge=10, le=2000, description="camera: take so many at least")
    # Over half a metre too few items passed to tell the camera's own pattern over the picture from a scale,
    # and one belt of six was known to 0.1 % and no better; over this way all were.
    travel_m: float = Field(
        default=1.5, gt=0, le=20, description="camera: and watch for so long a way of the items"
    )
    standing_s: float = Field(default=1.0, gt=0, le=60, description="no count for so long: the belt stands")
    patience_s: float = Field(
        default=30.0, gt=0, le=3600, description="wait so long for a belt that stands, or for items"
    )
    touches: int = Field(
        default=2, ge=2, le=20, description="touch: more than two leave residuals to judge by"
    )
    touch_sigma_m: float = Field(
        default=0.0003, gt=0, le=0.01, description="touch: how well a mark is met, per axis"
    )
    max_duration_s: float = Field(
        default=1800.0, gt=0, description="the run is ended when it takes longer, s"
    )
    accept: Acceptance = Field(default_factory=lambda: Acceptance(), description="who accepts the result")

    @model_validator(mode="after")
    def _camera_knows_the_belt(self) -> Self:
        if self.source == "camera" and self.belt_z_m is None:
            raise ValueError("belt_z_m is needed with source = 'camera': the height of the belt in the base")
        return self
