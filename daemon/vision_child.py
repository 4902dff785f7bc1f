"""Entry point of the vision child: hands the detectors of ``calibration`` to the camera driver."""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from calibration.items import ItemDetector, ItemSpec
from calibration.targets import make_target
from cell.devices import Intrinsics
from drivers.oak.child import Detectors, main


def make_items(spec: Mapping[str, Any]) -> Callable[[Intrinsics], ItemDetector]:
    """The item detector that ``spec`` describes, for any camera."""
    return partial(ItemDetector, ItemSpec.from_mapping(spec))


if __name__ == "__main__":
    main(Detectors(make_target, make_items))
