"""What a run works with, resolved once at its start; nothing of it changes while the run goes on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, Self

CONTROLLER: Mapping[str, Any] = {"name": "controller"}


@dataclass(frozen=True)
class RunValues:
    """The cell as a run has it: as configured, with the calibrations in effect.

    What stands below a name has the form of the configuration or of the data formats: ``robot`` and
    ``observed_robot`` are ROBOTs, ``tool`` and ``limits`` the sections of those names, ``poses`` joint angles
    (rad) and ``targets`` the target sections, both by name.

    ``calibration``: by setup of a capture, the (6,) poses ``X`` and ``W`` as far as they are known.
    ``belt``: ``m_per_count`` and ``dir``. ``time_offset_s``: by role, the offset in effect (``effective``)
    and what the driver has subtracted already (``applied``), and for a measured one in effect its standard
    deviation (``sigma``), of which an encoder's may have that of the camera in it (``camera_sigma``).
    ``kinematics``: by role, the calibrated arm in effect or None. ``arm_model``: the
    model that the run goes by, ``{"name": "controller"}`` or
    ``{"name": "kinematics.<device>", "version": n}``.

    By name in the ledger: ``configured`` has the configured value, ``versions`` the version in effect, and
    ``made_with`` the model of the arm that this version was made with, and ``uncertainty`` what the result
    that it comes from states: of a camera the covariance ``cov`` and its ``budget``, the accuracy of the
    ``arm``, the ``lens``, and the ``target`` with its printed size ``target_scale``; of a belt
    ``m_per_count_95``, ``dir_95_rad`` and, level alone, ``half_level_rad``.
    """

    robot: Mapping[str, Any]
    observed_robot: Mapping[str, Any] | None = None
    tool: Mapping[str, Any] = field(default_factory=dict)
    use_kinematics: bool = False
    payload_kg: float = 0.0
    centre_of_mass_m: Sequence[float] = (0.0, 0.0, 0.0)
    limits: Mapping[str, Any] = field(default_factory=dict)
    poses: Mapping[str, Sequence[float]] = field(default_factory=dict)
    targets: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    calibration: Mapping[str, dict[str, Any] | None] = field(default_factory=dict)
    laser_reference: Mapping[str, Any] | None = None
    belt: Mapping[str, Any] | None = None
    time_offset_s: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    kinematics: Mapping[str, Mapping[str, Any] | None] = field(default_factory=dict)
    arm_model: Mapping[str, Any] = field(default_factory=lambda: dict(CONTROLLER))
    configured: Mapping[str, Any] = field(default_factory=dict)
    versions: Mapping[str, int] = field(default_factory=dict)
    made_with: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    uncertainty: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @classmethod
    def of(cls, document: Mapping[str, Any]) -> Self:
        """From ``values`` of a ``run.json``; what an earlier version did not write has its default."""
        return cls(**{f.name: document[f.name] for f in fields(cls) if f.name in document})

    def as_dict(self) -> dict[str, Any]:
        """As ``run.json`` keeps them."""
        return {f.name: getattr(self, f.name) for f in fields(self)}
