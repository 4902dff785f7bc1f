"""The cell as the page shows it to its integrator: devices, findings, who may write, log, and registers."""

from typing import Any

from aiohttp import web

from cell.errors import error
from daemon.engine import Engine
from daemon.log_lines import RecentLog
from daemon.modbus import register_table
from daemon.modbus.table import Register
from daemon.plc import PlcFace
from daemon.recent_writes import RecentWrites
from daemon.web.answers import Visitors, json_answer


class CellView:
    """What is read of configuration, log and registers; all of it is in memory."""

    def __init__(
        self, engine: Engine, plc: PlcFace, writes: RecentWrites, log: RecentLog, visitors: Visitors
    ) -> None:
        self._engine, self._plc, self._writes, self._log = engine, plc, writes, log
        self._visitors = visitors

    def routes(self) -> list[web.RouteDef]:
        return [
            web.get("/api/cell", self.cell),
            web.get("/api/log", self.log),
            web.get("/api/plc", self.plc),
        ]

    async def cell(self, request: web.Request) -> web.Response:
        """Roles, findings of the configuration, and who may write what from where."""
        self._visitors.require_look(request)
        config = self._engine.context.config
        users = {name: user.role for name, user in config.http.user.items()}
        return json_answer(
            {
                "config": config.source,
                "checksum": f"{config.checksum:04X}",
                "roles": config.robot.roles(),
                "problems": config.problems,
                "warnings": config.warnings,
                "poses": config.poses,
                "writers": {
                    "socket": config.cell.control_socket,
                    "page": config.http.bind,
                    "users": users,
                    "look_without_login": config.http.look_without_login,
                    "modbus": config.modbus.bind if config.modbus.enabled else None,
                    "modbus_write": config.modbus.allow_write,
                    "modbus_clients": config.modbus.allow_clients,
                    "modbus_accept": config.modbus.allow_accept,
                },
            }
        )

    async def log(self, request: web.Request) -> web.Response:
        """The newest lines of the daemon's log, for who is logged in: it names addresses and files."""
        if self._visitors.session(request) is None:
            raise error("LOGIN_NEEDED")
        return json_answer(self._log.lines())

    async def plc(self, request: web.Request) -> web.Response:
        """The status block as a PLC reads it, register by register, and the last commands of a PLC."""
        self._visitors.require_look(request)
        values = self._plc.snapshot()
        commands = [line for line in self._writes.newest() if line["channel"] == "modbus"]
        return json_answer(
            {
                "registers": [_register(r, values.get(r.name)) for r in register_table().readable],
                "commands": commands[-10:],
                "served": self._engine.context.config.modbus.enabled,
            }
        )


def _register(register: Register, value: Any) -> dict[str, Any]:
    number = value if isinstance(value, int | float) else 0
    bits = [text for bit, text in enumerate(register.bits) if int(number) >> bit & 1]
    return {
        "address": register.address,
        "name": register.name,
        "type": register.type,
        "unit": register.unit,
        "meaning": register.meaning,
        "value": value,
        "words": register.values.get(int(number)) if register.values else None,
        "bits": bits if register.bits else None,
    }
