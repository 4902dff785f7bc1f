"""Entry point of the vision child: hands the detectors of ``calibration`` to the camera driver."""

from collections.abc import Callable, Mapping
from typing import Any

from cell.collector import without_collector

with without_collector():
    from calibration.items import ItemDetector, ItemSpec
    from calibration.targets import make_target
    from cell.calibrated_lens import calibrated_lens
    from cell.devices import Intrinsics
    from drivers.oak.child import Detectors, main


def make_items(spec: Mapping[str, Any]) -> Callable[[Intrinsics], ItemDetector]:
    """The item detector that ``spec`` describes, for any camera: with the ``lens`` in it where that is of
    pictures of the size that the camera tells."""
    of = ItemSpec.from_mapping(spec)
    return lambda told: ItemDetector(of, calibrated_lens(spec.get("lens"), told) or told)


if __name__ == "__main__":
    main(Detectors(make_target, make_items))
