"""What a twin makes of each key in the section of a device: taken over, of no effect there, or not in it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from pydantic import BaseModel

# Where and how a device is reached, who it has to be, and how long an answer may take: a twin has no wires.
_REACHED = (
    "driver scenario host url unit bus source serial model expect_serial timeout_s connect_timeout_s "
    "open_timeout_s lost_after_failures tls_ca tls_certificate tls_key tls_server_name"
)


@dataclass(frozen=True)
class SectionKeys:
    """Keys of the drivers that play one role. ``taken``: the twin, or the object in it, goes by them.

    ``no_effect``: how a number is written on the wire, and what ends in the same result. ``missing``: what a
    twin does not have, although a cell with another value may behave in another way.
    """

    taken: frozenset[str]
    no_effect: frozenset[str]
    missing: frozenset[str]

    @property
    def all(self) -> frozenset[str]:
        """Every key that is known."""
        return self.taken | self.no_effect | self.missing


def _keys(taken: str, no_effect: str, missing: str) -> SectionKeys:
    return SectionKeys(*(frozenset(keys.split()) for keys in (taken, f"{_REACHED} {no_effect}", missing)))


_CAMERA = _keys(
    taken="width height fps exposure_s row_time_s depth stereo_height stereo_subpixel_bits frame_timeout_s",
    no_effect="group_within_s",  # a twin exposes colour and depth together
    missing="focus stereo_preset stereo_median stereo_filters stereo_confidence dot_projector iso "
    "time_offset_s",
)
SECTIONS: Mapping[str, SectionKeys] = {
    "arm": _keys(
        taken="servo_lookahead_s servo_gain joint_tolerance_rad position_tolerance_m rotation_tolerance_rad",
        # Of links that fall silent and of stops, none of which a rehearsal has.
        no_effect="stale_after_s silent_after_s lost_after_s stop_decel_m_s2 watchdog_min_hz",
        missing="rtde_frequency_hz time_offset_s follow_decel_rad_s2",
    ),
    "flange_camera": _CAMERA,
    "fixed_camera": _CAMERA,
    "beams": _keys(
        taken="inputs arm poll_period_s filter_s module use_counters counters",
        no_effect="levels uptime",
        missing="time_offset_s",
    ),
    "place_inputs": _keys(
        taken="poll_period_s arm",
        no_effect="inputs levels uptime module use_counters counters",
        missing="filter_s time_offset_s",
    ),
    "tracker": _keys(
        taken="sigma0_m sigma_per_m measure_with min_readings poll_period_s request",
        # How its numbers are written and its distances are made, whose noise the section states.
        no_effect="reflectors checksum reading tracking edm_mode inclination temperature_c pressure_pa "
        "pattern columns delimiter decimal ignore encoding pressure_unit valid_values length_unit "
        "angle_unit horizontal vertical axes left_handed only_from silence_s broken_after_s lost_after_bad "
        "distance_timeout_s motion_timeout_s",
        missing="time_offset_s search_window_rad find_radius_m min_range_m max_range_m stamp_uncertainty_s",
    ),
    "belt": _keys(
        taken="period_s range_counts width_bits lost_after_s",
        # What a count is worth was measured with the encoder as it is set.
        no_effect="node tpdo cob_id speed heartbeat_s units_per_revolution id extended offset_bytes "
        "byte_order signed",
        missing="time_offset_s",
    ),
    "gripper": _keys(
        taken="output confirm moves_s",
        no_effect="arm invert_output open_output invert_confirm poll_period_s read_back confirm_table "
        "activate",
        missing="blow_off_s closed open speed force",
    ),
    "observed_arm": _keys(
        taken="allow_requests rest_window_s rest_spread_rad poll_period_s",
        no_effect="joints moving handshake stated_serial",
        missing="time_offset_s",
    ),
}


def not_in_twin(roles: Mapping[str, str], sections: Mapping[str, BaseModel]) -> Iterator[str]:
    """``KEYS of DEVICE`` for each device of ``roles`` whose section gives keys that a twin does not have.

    Keys that no table here knows, as those of another package's driver, are among them.
    """
    for role, device in roles.items():
        known = SECTIONS[role]
        section = sections[device]
        if missing := sorted(section.model_fields_set - known.taken - known.no_effect):
            yield f"{', '.join(missing)} of {device}"
