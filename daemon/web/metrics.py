"""``/metrics`` for Prometheus: the state of the cell as numbers, in its text format."""

from collections.abc import Iterator
from importlib.metadata import version

from aiohttp import web
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric
from prometheus_client.registry import Collector

from cell.errors import error
from daemon.engine import Engine
from daemon.web.answers import Visitors, address_of

CONTENT_TYPE = "text/plain; version=0.0.4; charset=utf-8"
BEARER = "Bearer "


class Metrics:
    """For who may look, and for a program with a user's token (``Authorization: Bearer TOKEN``)."""

    def __init__(self, engine: Engine, visitors: Visitors) -> None:
        self._visitors = visitors
        self._registry = CollectorRegistry(auto_describe=False)
        self._registry.register(CellCollector(engine))

    def routes(self) -> list[web.RouteDef]:
        return [web.get("/metrics", self.metrics)]

    async def metrics(self, request: web.Request) -> web.Response:
        if not self._visitors.may_look(request):
            given = request.headers.get("Authorization", "")
            if not given.startswith(BEARER):
                raise error("LOGIN_NEEDED")
            self._visitors.sessions.known(given.removeprefix(BEARER).strip(), address_of(request))
        text = generate_latest(self._registry)
        return web.Response(body=text, headers={"Content-Type": CONTENT_TYPE})


class CellCollector(Collector):
    """Reads the engine's status at each scrape; nothing is counted twice."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def collect(self) -> Iterator[Metric]:
        status = self._engine.status()
        info = GaugeMetricFamily("cellward_info", "Which cell this is.", labels=("cell", "version", "twin"))
        info.add_metric((status["cell"], version("cellward"), str(status["twin"]).lower()), 1)
        yield info
        error_code = status["error"]["code"] if status["error"] else 0
        for name, text, value in (
            ("cellward_packml_state", "PackML number of the state.", status["packml_number"]),
            ("cellward_job", "Number of the job that runs; 0: none.", status["job_number"]),
            ("cellward_run", "Number of the run; 0: none.", status["run_id"] or 0),
            ("cellward_step", "Steps done in the run.", status["step"]),
            ("cellward_steps", "Steps of the run.", status["steps"]),
            ("cellward_error_code", "Code of the last error; 0: none.", error_code),
            ("cellward_motion_latched", "1: motion is locked after a fault.", int(status["latched"])),
            ("cellward_prompt", "1: a person is waited for.", int(status["prompt"] is not None)),
            ("cellward_results_waiting", "Results that wait for a decision.", len(status["waiting"])),
            ("cellward_disk_free_bytes", "Free on the disk of the runs.", status["disk"].get("free_bytes")),
            ("cellward_loop_lag_seconds", "Longest recent lag of the loop.", status["loop_lag"].get("max_s")),
        ):
            if value is not None:
                yield GaugeMetricFamily(name, text, value=value)
        yield from _devices(status["devices"])
        live = GaugeMetricFamily("cellward_live", "Numbers of the running job, SI units.", labels=("name",))
        for name, value in status["live"].items():
            live.add_metric((name,), value)
        yield live


def _devices(devices: dict[str, dict[str, object]]) -> Iterator[Metric]:
    ready = GaugeMetricFamily("cellward_device_ready", "1: the device is ready.", labels=("device",))
    losses = CounterMetricFamily("cellward_device_losses", "Times it was lost.", labels=("device",))
    for name, device in devices.items():
        ready.add_metric((name,), float(device["state"] == "READY"))
        losses.add_metric((name,), float(str(device["losses"])))
    yield ready
    yield losses
