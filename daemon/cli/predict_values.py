"""What the predictions share: the values of a run as the configuration alone has them, and their findings."""

from typing import Any

from daemon.config import CellConfig


def configured_values(config: CellConfig) -> dict[str, Any]:
    """Arm, tool, payload, limits and poses; the ledger and the devices may know better when a job starts."""
    return {
        "robot": config.robot.robot_spec(),
        "tool": config.robot.tool.model_dump(mode="json"),
        "use_kinematics": config.robot.use_kinematics,
        "payload_kg": config.robot.payload_kg,
        "centre_of_mass_m": list(config.robot.centre_of_mass_m),
        "limits": config.limits.model_dump(mode="json"),
        "poses": {name: list(q) for name, q in config.poses.items()},
    }


def found_in(predictions: list[dict[str, Any]], kind: str) -> list[str]:
    """The ``problems`` (a job cannot succeed) or ``cautions`` of all predictions, each with its job."""
    return [f"{job['job']}: {text}" for job in predictions for text in job.get(kind, [])]
