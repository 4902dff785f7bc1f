"""How a job looks at reflectors with a tracker: keys that are the same wherever one measures at rest."""

from pydantic import Field

from cell.formats.reading import Strict


class Looking(Strict):
    """Base of the configuration of such a job."""

    settle_s: float = Field(default=0.5, ge=0, le=60, description="wait at rest before a measurement")
    window_s: float = Field(
        default=1.0, gt=0, le=60, description="length of the window whose readings make one stable point"
    )
    max_scatter_m: float = Field(
        default=0.0002, gt=0, le=0.01, description="largest scatter of the readings in the window"
    )
    measure_timeout_s: float = Field(
        default=10.0, gt=0, le=300, description="longest wait for one stable point"
    )
    find_timeout_s: float = Field(default=15.0, gt=0, le=300, description="longest search for a reflector")
    reacquire_wait_s: float = Field(
        default=1.0, ge=0, le=60, description="before a lost reflector is searched for"
    )
