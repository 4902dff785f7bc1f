"""A cell that was never seen: a scenario drawn from what its configuration tells, with usual imperfections.

:func:`likely_scenario` and :func:`device_keys` are all that others need; each file here draws one part and
says where its sizes come from. Two seeds give two cells that the same configuration fits.
"""

from fakes.likely.devices import DRIVERS, device_keys
from fakes.likely.draw import CLOCK, likely_scenario

__all__ = ["CLOCK", "DRIVERS", "device_keys", "likely_scenario"]
