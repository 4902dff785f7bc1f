"""What GeoCOM's return codes mean to us. A code that is not in the table is told with its number.

Numbers and names are those of the makers' manuals.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum

from cell.errors import CellError, error


class Meaning(StrEnum):
    """What follows from a return code."""

    OK = "ok"
    WARNING = "warning"  # the data are valid, the instrument doubts their accuracy
    NO_DISTANCE = "no distance"  # angles only: nothing reflects
    NO_TARGET = "no target"  # searched for and not found
    BUSY = "busy"  # asked again until the deadline
    LINE = "line"  # the request or its reply was damaged: asked again
    UNKNOWN_CALL = "unknown call"  # this instrument does not have the procedure
    REFUSED = "refused"
    SETTING = "setting"
    ANGLES = "angles"
    POWER = "power"
    FAULT = "fault"


@dataclass(frozen=True)
class ReturnCode:
    """One line of the table."""

    number: int
    name: str
    meaning: Meaning
    words: str

    def __str__(self) -> str:
        return f"{self.number} {self.name}, {self.words}" if self.name else f"{self.number}, {self.words}"

    @property
    def has_data(self) -> bool:
        """Whether what the call returns is valid."""
        return self.meaning in (Meaning.OK, Meaning.WARNING)

    def as_error(self, what: str) -> CellError:
        """The coded error for a call that ended with this code; ``what`` names device and call."""
        return error(_ERRORS[self.meaning], f"{what} ended with {self}")


_ERRORS = {
    Meaning.NO_DISTANCE: "TRACKER_NO_TARGET",
    Meaning.NO_TARGET: "TRACKER_NO_TARGET",
    Meaning.BUSY: "TRACKER_BUSY",
    Meaning.LINE: "DEVICE_LOST",
    Meaning.UNKNOWN_CALL: "TRACKER_REFUSED",
    Meaning.REFUSED: "TRACKER_REFUSED",
    Meaning.SETTING: "TRACKER_SETTING",
    Meaning.ANGLES: "TRACKER_NOT_LEVEL",
    Meaning.POWER: "TRACKER_POWER",
    Meaning.FAULT: "TRACKER_FAULT",
}

_TABLE = """
0     OK                            ok            carried out
1     UNDEFINED                     fault         an error that the instrument does not explain
2     IVPARAM                       refused       a parameter is not valid
3     IVRESULT                      fault         the result is not valid
4     FATAL                         fault         a fatal error
5     NOT_IMPL                      unknown call  not implemented in this instrument
6     TIME_OUT                      busy          it took too long
7     SET_INCOMPL                   setting       the set-up is not complete
8     ABORT                         refused       aborted at the instrument or by another program
9     NOMEMORY                      fault         no memory left
10    NOTINIT                       fault         a part of the instrument is not initialised
12    SHUT_DOWN                     power         it is shutting down
13    SYSBUSY                       busy          used by something else
14    HWFAILURE                     fault         hardware failure
15    ABORT_APPL                    refused       aborted by a key of its panel
16    LOW_POWER                     power         the supply is too low
18    BATT_EMPTY                    power         the battery is empty
21    OUT_OF_TEMP                   fault         too hot or too cold
22    INSTRUMENT_TILT               angles        tilted beyond its range
23    COM_SETTING                   line          communication error
25    SLEEP_MODE                    line          it has gone to sleep
26    NOTOK                         refused       not carried out
27    NA                            unknown call  not available in this instrument
29    STOPPED                       refused       stopped
257   ANG_ERROR                     angles        angles and inclination are not valid
258   ANG_INCL_ERROR                angles        the inclination is not valid
259   ANG_BAD_ACC                   angles        angles are not accurate
260   ANG_BAD_ANGLE_ACC             angles        angles are not accurate
261   ANG_BAD_INCLIN_ACC            angles        the inclination is not accurate
269   ANG_HZ_MOVED                  angles        it turned while the inclination was measured
273   ANG_TIME_OUT                  angles        the angles took too long
512   ATA_NOT_READY                 busy          target recognition is not ready
514   ATA_SEVERAL_TARGETS           no target     several reflectors in view
515   ATA_BIG_SPOT                  no target     the spot is too big; the reflector is too near
516   ATA_BACKGROUND                no target     the background is too bright
517   ATA_NO_TARGETS                no target     no reflector in view
519   ATA_SPOT_ON_EDGE              no target     the reflector is at the edge of the view
522   ATA_BLOOMING                  no target     blinded, or the reflector is at the edge of the view
524   ATA_STRANGE_LIGHT             no target     the light is not the reflector's
525   ATA_V24_FAIL                  fault         target recognition does not answer inside the instrument
527   ATA_HZ_FAIL                   no target     no reflector seen horizontally
528   ATA_V_FAIL                    no target     no reflector seen vertically
539   ATA_ATR_SYSTEM_ERR            fault         target recognition failed
769   EDM_COMERR                    fault         the distance meter does not answer inside the instrument
770   EDM_NOSIGNAL                  no distance   no signal
771   EDM_PPM_MM                    setting       corrections of the distance are not zero
772   EDM_METER_FEET                setting       the distance is not in metres
775   EDM_TIMEOUT                   no distance   the signal is too weak, or the beam is interrupted
776   EDM_FLUKT_ERR                 no distance   the air is too turbulent, or the beam is interrupted
786   EDM_BUSY                      busy          the distance meter is working
818   EDM_DISTRANGE_ERR             no distance   too near or too far
819   EDM_SIGNTONOISE_ERR           no distance   the signal is too weak
823   EDM_MULTRG_ERR                no distance   several reflectors in the beam
829   EDM_DIST_TOO_SHORT            no distance   too near
1283  TMC_NO_FULL_CORRECTION        warning       not all corrections could be applied
1284  TMC_ACCURACY_GUARANTEE        warning       the accuracy is not guaranteed
1285  TMC_ANGLE_OK                  no distance   angles are valid, but there is no distance
1288  TMC_ANGLE_NO_FULL_CORRECTION  no distance   angles without all corrections, and no distance
1289  TMC_ANGLE_ACCURACY_GUARANTEE  no distance   angles of unsure accuracy, and no distance
1290  TMC_ANGLE_ERROR               angles        angles or inclination could not be measured
1291  TMC_DIST_PPM                  setting       the distance meter's ppm or mode is wrong
1292  TMC_DIST_ERROR                no distance   the distance could not be measured; the target is gone
1293  TMC_BUSY                      busy          a measurement is under way
1294  TMC_SIGNAL_ERROR              no distance   the signal could not be measured
1380  TMC_OLD_PLANE                 angles        the plane of inclination is too old
1381  TMC_NO_PLANE                  angles        there is no plane of inclination
1383  TMC_INCLINE_ACC               angles        the plane of inclination is not accurate
1392  TMC_INC_ERROR                 angles        the inclination could not be measured
1792  MOT_UNREADY                   fault         the motors are not ready
1793  MOT_BUSY                      busy          the motors are working
1799  MOT_NOT_LOCK                  no target     not locked to a target
1801  MOT_V_ENCODER                 fault         the vertical circle failed
1802  MOT_HZ_ENCODER                fault         the horizontal circle failed
1804  MOT_HZ_MOTOR_ERROR            fault         the horizontal motor failed
1805  MOT_V_MOTOR_ERROR             fault         the vertical motor failed
1806  MOT_TIMEOUT                   fault         the motors took too long
3073  COM_CANT_ENCODE               line          the request could not be written
3074  COM_CANT_DECODE               line          the reply could not be read
3076  COM_CANT_RECV                 line          the request could not be received
3077  COM_TIMEDOUT                  line          the request was not complete in time
3078  COM_WRONG_FORMAT              line          the request was damaged
3079  COM_VER_MISMATCH              refused       another version of the protocol
3080  COM_CANT_DECODE_REQ           refused       it cannot read the parameters
3081  COM_PROC_UNAVAIL              unknown call  this instrument does not have the procedure
3082  COM_CANT_ENCODE_REP           fault         it cannot write its reply
3083  COM_SYSTEM_ERR                fault         an error that the instrument does not explain
3085  COM_FAILED                    fault         an error that the instrument does not explain
3087  COM_INTR                      line          the call was interrupted
3093  COM_TR_ID_MISMATCH            line          wrong transaction number
3100  COM_OVERRUN                   line          the line was too long
3101  COM_SRVR_RX_CHECKSUM_ERROR    line          the request's check sum is wrong
3107  COM_CONS_REQ                  busy          requests came too fast
3108  COM_SRVR_IS_SLEEPING          line          it has gone to sleep
3109  COM_SRVR_IS_OFF               power         it was switched off
3110  COM_NO_CHECKSUM               setting       it has no check sums; set checksum = false
8704  AUT_TIMEOUT                   no target     position or target was not reached in time
8705  AUT_DETENT_ERROR              refused       it cannot turn there
8706  AUT_ANGLE_ERROR               angles        angles could not be measured
8707  AUT_MOTOR_ERROR               fault         the motors failed
8708  AUT_INCACC                    warning       the position was not reached exactly
8709  AUT_DEV_ERROR                 no target     the deviation from the target could not be measured
8710  AUT_NO_TARGET                 no target     no target detected
8711  AUT_MULTIPLE_TARGETS          no target     several targets detected
8712  AUT_BAD_ENVIRONMENT           no target     too much light, or none
8713  AUT_DETECTOR_ERROR            no target     the target's image could not be used
8714  AUT_NOT_ENABLED               refused       target recognition is not switched on
8715  AUT_CALACC                    fault         target recognition needs its adjustment
8716  AUT_ACCURACY                  warning       the target was not reached exactly
8717  AUT_DIST_STARTED              warning       a distance measurement was started
8718  AUT_SUPPLY_TOO_HIGH           power         the external supply is too high
8719  AUT_SUPPLY_TOO_LOW            power         the supply is too low
8720  AUT_NO_WORKING_AREA           setting       there is no search window
8722  AUT_NO_DATA                   no target     no data
8723  AUT_SIDECOVER_ERR             refused       the side cover is open
8724  AUT_OUT_OF_SYNC               fault         telescope and angles are not in step
8725  AUT_NO_LOCK                   no target     it cannot lock to a target here
9217  BAP_CHANGE_ALL_TO_DIST        warning       the measuring program was changed
"""


def _read(table: str) -> Iterator[ReturnCode]:
    for line in table.strip().splitlines():
        number, name, rest = line.split(maxsplit=2)
        meaning, words = rest.split("  ", maxsplit=1)
        yield ReturnCode(int(number), name, Meaning(meaning), words.strip())


CODES = {code.number: code for code in _read(_TABLE)}


def return_code(number: int) -> ReturnCode:
    """The table's line for ``number``, or one that says that the number is unknown."""
    unknown = "a return code that is not known here; look it up in the instrument's manual"
    return CODES.get(number) or ReturnCode(number, "", Meaning.REFUSED, unknown)
