"""The spreads in the result of a hand-eye calibration, field by field: how consistent its estimates are."""

from pydantic import Field

from cell.formats.result import (
    Metres,
    Part,
    Pose,
    Radians,
    Vector,
)


class Distance(Part):
    """A distance between poses."""

    t: Metres = Field(description="Of the translation.")
    r: Radians = Field(description="Of the rotation.")


class LeftOut(Part):
    """A distance between poses; empty when leaving some out leaves too few."""

    t: Metres | None = Field(default=None, description="Of the translation.")
    r: Radians | None = Field(default=None, description="Of the rotation.")


class Spread(Part):
    """How consistent weighted estimates of three poses each are. That is no accuracy.

    Each is one step from the weighted solution, so it is smaller than what unweighted ones give
    (`neighbour_spread`), and cannot be held against figures that are published for the cone method.
    """

    t: Vector = Field(description="Along the axes.")
    t_norm: Metres = Field(description="Its length.")
    r: Radians = Field(description="Of the rotation.")
    floor_t: Metres | None = Field(description="What noise alone gives; not known where the arm is in it.")
    floor_r: Radians | None = Field(description="What noise alone gives; not known where the arm is in it.")
    resolved: bool | None = Field(description="Whether the spread stands out from noise.")

    @property
    def floor_known(self) -> bool:
        """Earlier versions left the noise of bare poses out, and wrote a floor of 0."""
        return bool(self.floor_t)


class TwoSpreads(Part):
    """The two consistency figures by arm, lens and target as they are configured."""

    spread_within: Spread | None = Field(description="Of the estimates within placements.")
    spread_across: Spread | None = Field(description="Of the estimates of several placements.")


class BaseSpread(Part):
    """The two spreads of the placements at one place of the target's stand."""

    within: Spread | None = Field(description="Of the estimates within placements.")
    across: Spread | None = Field(description="Of the estimates of several placements.")


class PlainSpread(Part):
    """A standard deviation, without its noise floor."""

    t: Vector = Field(description="Along the axes.")
    t_norm: Metres = Field(description="Its length.")
    r: Radians = Field(description="Of the rotation.")


class NeighbourBase(Part):
    """The unweighted spreads of the placements at one place of the target's stand."""

    within: PlainSpread | None = Field(description="Of the estimates within placements.")
    across: PlainSpread | None = Field(description="Of the means of several placements.")


class NeighbourSpread(Part):
    """The classic cone method: unweighted AX = XB on each three neighbours on the cone.

    Nothing is weighted or left out as a blunder, so these figures may be held against published ones.
    """

    within: PlainSpread | None = Field(
        description="RMS over placements of the standard deviation of the estimates of each."
    )
    across: PlainSpread | None = Field(description="Standard deviation of the means of the placements.")
    across_least_squares: PlainSpread | None = Field(
        description="The same with the least-squares estimate of each placement for its mean."
    )
    by_base: dict[str, NeighbourBase] = Field(description="The two by place of the stand, where told apart.")
    pose: Pose | None = Field(description="The camera's pose as the mean of the means.")
    triples: int = Field(description="How many estimates there are.")
    skipped: int = Field(description="How many sets of three neighbours determine none.")
    order: str = Field(description="`planned`: by the place on the cone; `observations`: as they were taken.")
    not_determined: str | None = Field(
        default=None, description="In words, why a spread and the pose are not determined."
    )
    verdict: str | None = Field(
        default=None,
        description="In words, whether they keep their limits; of a run that has limits for them.",
    )


class Estimates(Part):
    """What simple solvers find in one placement."""

    mean: Pose | None = Field(description="Mean of the estimates from three poses each.")
    least_squares: Pose | None = Field(description="Of all poses of the placement.")
    triples: int = Field(description="How many sets of three poses there are.")
    skipped: int = Field(description="How many of them were too alike.")
