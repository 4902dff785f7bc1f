"""The controller's true state as plain values, for tests and for ``cellward-twin truth``."""

from typing import Any

from fakes.ur.controller import Controller


def controller_state(controller: Controller) -> dict[str, Any]:
    """JSON-able snapshot; lengths in m, angles in rad, times in s."""
    robot = controller.robot
    now = robot.instant(robot.now())
    q, qd = robot.arm.track.at(now.t)  # as they are, not as they are reported
    program = robot.runtime.program
    return {
        "q": q.tolist(),
        "qd": qd.tolist(),
        "tcp_pose": now.tcp_pose6,
        "tcp_offset": list(robot.tool.offset6),
        "payload_kg": robot.tool.payload,
        "moving": robot.arm.moving(now.t),
        "robot_mode": robot.safety.robot_mode.name,
        "safety_mode": robot.safety.mode.name,
        "control_mode": robot.modes.mode.name,
        "runtime_state": robot.runtime.state.name,
        "program": program.name if program is not None else None,
        "remote": robot.remote,
        "serial": robot.identity.serial,
        "stamp": now.stamp,
        "cycles": controller.ticker.cycles,
        "lost_cycles": controller.ticker.lost,
        "overrun_cycles": controller.ticker.overrun,
        "rtde_clients": len(controller.rtde.connections),
        "owned_inputs": sorted(controller.rtde.ownership.owners),
        "digital_out": robot.io.digital_out,
        "registers": {k: v for k, v in robot.registers.items() if v},
    }
