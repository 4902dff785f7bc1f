"""What ``[device.<camera>]`` in cell.toml may say."""

from typing import Literal, Self

from pydantic import Field, model_validator

from cell.formats.reading import Strict
from drivers.life import TIME_OFFSET

FRAMES_SCHEME = "frames+unix://"


class OakConfig(Strict):
    """An OAK device, or a frame socket in its place."""

    source: str = Field("oak", description=f'"oak" or "{FRAMES_SCHEME}/path/to/socket"')
    host: str | None = Field(
        None,
        min_length=1,
        description="address of an OAK on a network; without DHCP it has 169.254.1.222 (Luxonis)",
    )
    expect_serial: str | None = Field(None, description="refuse another device; picks one of several OAKs")
    width: int = Field(
        1280, ge=320, le=4096, multiple_of=16, description="colour and aligned depth, oak only"
    )
    height: int = Field(800, ge=240, le=4096, multiple_of=8, description="of the colour picture, pixels")
    fps: float = Field(10.0, ge=1.0, le=60.0, description="pictures a second")
    exposure_s: float | None = Field(None, gt=0, le=0.033, description="absent: automatic exposure")
    focus: int | None = Field(
        None,
        ge=0,
        le=255,
        description="position of a lens that can move; absent: the one it was calibrated at",
    )
    row_time_s: float | None = Field(
        None,
        ge=0,
        le=0.0002,
        description="from one row of the picture to the next, 0 of a global shutter; absent: by the sensor",
    )
    group_within_s: float = Field(
        0.005,
        gt=0,
        le=0.5,
        description="colour and depth of one frame are exposed no further apart; raise it where none are",
    )
    depth: bool = Field(
        True,
        description="false: of a camera without a stereo pair, as an OAK-1, or depth that nobody wants",
    )
    stereo_preset: Literal["accuracy", "default", "density", "high_detail", "robotics"] | None = Field(
        None, description="of depthai's stereo node, with its filters; absent: the node's own"
    )
    stereo_height: Literal[400, 720, 800] = Field(
        400, description="of the pictures that are matched: 640 x 400, 1280 x 720 or 1280 x 800 pixels"
    )
    stereo_subpixel_bits: Literal[3, 4, 5] | None = Field(
        None, description="steps of a pixel's disparity are 2 to this power; absent: the preset's, else 3"
    )
    stereo_median: Literal["off", "3x3", "5x5", "7x7"] | None = Field(
        None, description="median filter of disparity; absent: the preset's"
    )
    stereo_filters: list[Literal["speckle", "spatial", "temporal"]] | None = Field(
        None, description="filters of depth: these and none of the others; absent: the preset's"
    )
    stereo_confidence: int | None = Field(
        None, ge=0, le=255, description="a match that costs more is left out; absent: the preset's"
    )
    dot_projector: float = Field(
        0.8, ge=0, le=1, description="intensity while items are looked for, of a device that has one"
    )
    iso: int = Field(200, ge=100, le=1600, description="sensor gain with a fixed exposure")
    time_offset_s: float = Field(0.0, ge=-0.5, le=0.5, description=TIME_OFFSET)
    frame_timeout_s: float = Field(
        2.5,
        ge=0.2,
        le=10.0,
        description="age of the newest frame that is a loss; a late one is not stale, it has its stamp",
    )
    open_timeout_s: float = Field(15.0, ge=1.0, le=18.0, description="start of the child to the first frame")

    @model_validator(mode="after")
    def _known_source(self) -> Self:
        path = self.source.removeprefix(FRAMES_SCHEME)
        if self.source != "oak" and (path == self.source or not path.startswith("/")):
            raise ValueError(
                f'source {self.source!r} is neither "oak" nor {FRAMES_SCHEME} with an absolute path'
            )
        return self

    @model_validator(mode="after")
    def _heeded(self) -> Self:
        """A key that nothing would go by is a mistake."""
        of_pair = sorted(key for key in self.model_fields_set if key.startswith("stereo_"))
        if of_pair and not self.depth:
            raise ValueError(f"depth = false has no use for {of_pair[0]}: leave out one of them")
        if self.host is not None and self.source != "oak":
            raise ValueError('host is the address of an OAK: leave it out, or give source = "oak"')
        return self

    @model_validator(mode="after")
    def _median_of_three_bits(self) -> Self:
        if self.stereo_subpixel_bits not in (None, 3) and self.stereo_median not in (None, "off"):
            raise ValueError(
                "the device's median filter works on 3 subpixel bits: leave out stereo_median or "
                "stereo_subpixel_bits"
            )
        return self

    @property
    def socket_path(self) -> str | None:
        """The frame socket, or None for a real device."""
        return None if self.source == "oak" else self.source.removeprefix(FRAMES_SCHEME)
