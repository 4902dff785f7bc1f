"""Entry point of the vision child: hands the detectors of ``calibration`` to the camera driver."""

import os

from calibration.targets import make_target
from drivers.oak.child import main

if __name__ == "__main__":
    os.nice(10)  # the loop, which watches the arm, comes first
    main(make_target)
