"""Entry point of the vision child: hands the detectors of ``calibration`` to the camera driver."""

from calibration.targets import make_target
from drivers.oak.child import main

if __name__ == "__main__":
    main(make_target)
