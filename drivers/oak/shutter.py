"""How a sensor reads its picture: all rows at once, or one after the other."""

# Time from the first row to the last, s, of modes with up to 1080 rows and with more. Luxonis, documentation
# of the sensors: IMX378 and IMX214 have a rolling shutter, 15.4 us a row at 1080 rows, and 33 ms for all rows
# of a 4K mode; OV9282, OV9782 and AR0234 have a global one.
_READOUT_S = {
    "IMX378": (0.0167, 0.033),
    "IMX214": (0.0167, 0.033),
    "OV9282": (0.0, 0.0),
    "OV9782": (0.0, 0.0),
    "AR0234": (0.0, 0.0),
}
_BINNED_ROWS = 1080


def row_time_s(sensor: str, rows: int) -> float | None:
    """From one row to the next of a picture with ``rows`` rows; None for a sensor that is not known.

    The picture is taken to have the full height of the sensor's mode.
    """
    times = _READOUT_S.get(sensor.upper())
    return None if times is None else times[rows > _BINNED_ROWS] / rows
