"""From the text of ``cell.toml`` to a checked configuration, or to everything that is wrong with it."""

import binascii
import hashlib
import re
import stat
import tomllib
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field, SerializeAsAny, ValidationError, create_model

from cell.errors import error
from cell.formats.capture import TARGETS
from cell.kinds import lacking, plays
from cell.store.files import to_json
from daemon.config.checks import check_contradictions, check_names, check_units
from daemon.config.drivers import DRIVERS, bindings, driver_class
from daemon.config.faces import CanSection, HttpSection, ModbusSection
from daemon.config.findings import ConfigInvalid, Findings, did_you_mean
from daemon.config.limits_section import LimitsSection
from daemon.config.locate import locate
from daemon.config.models import CellSection, CheckDueSection, DeviceSection, FixedSections, SupervisorSection
from daemon.config.moved import put_in_place
from daemon.config.mqtt_section import MqttSection
from daemon.config.not_in_version import take_out
from daemon.config.plausible import check_plausible
from daemon.config.program_after import check_program_after
from daemon.config.recipes import Recipe, check_recipes
from daemon.config.robot import MAX_BYTES, ResolvedRobot, observed_spec, robot_spec
from daemon.config.roles import ROLES, devices_by_role, kind_of
from daemon.config.tables import tables
from daemon.config.tools import NamedToolSection, check_tools, has_plain_tool
from daemon.config.untold_loads import check_loads

DEEPEST = 16  # tables and arrays in each other
_LONG_KEY = re.compile(rf"(?:[\w\"'-]+[ \t]*\.[ \t]*){{{2 * DEEPEST}}}")


NO_PART_OF_A_RUN = frozenset({"http", "mqtt", "check_due"})  # sections that change nothing of what a run does
LATER = frozenset({"tool", "recipe"})  # without these tables a file keeps its digest; keys: GrownSection
OF_EVERY_JOB = frozenset({"procedure", "tool"})  # keys of [job.NAME] that are not its class's


class CellConfig(BaseModel):
    """The effective configuration of one cell. Immutable; the program never writes it back."""

    model_config = {"extra": "forbid", "frozen": True}

    source: str
    cell: CellSection
    supervisor: SupervisorSection
    robot: ResolvedRobot
    limits: LimitsSection
    poses: dict[str, list[float]]
    tool: dict[str, NamedToolSection]
    device: dict[str, SerializeAsAny[DeviceSection]]
    target: dict[str, dict[str, Any]]
    modbus: ModbusSection
    can: CanSection
    http: HttpSection
    check_due: CheckDueSection
    mqtt: MqttSection
    job: dict[str, dict[str, Any]]
    recipe: dict[str, Recipe]
    warnings: list[str] = Field(default_factory=list, exclude=True)
    problems: list[str] = Field(default_factory=list, exclude=True)  # each keeps one job from succeeding

    def job_section(self, job: str) -> dict[str, Any]:
        """The job's own keys of ``[job.NAME]`` as written; empty when the file has no such section."""
        return {key: value for key, value in self.job.get(job, {}).items() if key not in OF_EVERY_JOB}

    def part_of_a_run(self) -> dict[str, Any]:
        """What ``run.json`` keeps of it: all that may change what a run does."""
        content = self.model_dump(mode="json", exclude=set(NO_PART_OF_A_RUN))
        return {key: value for key, value in content.items() if value or key not in LATER}

    @property
    def checksum(self) -> int:
        """CRC-16 (XMODEM) of what is in effect: comments, order, the file's place, who may use the page or is
        told, and when a check is due do not change it."""
        return binascii.crc_hqx(self._in_effect(), 0)

    @property
    def digest(self) -> str:
        """SHA-256, in hexadecimal, of what :attr:`checksum` is made from: what a report names."""
        return hashlib.sha256(self._in_effect()).hexdigest()

    def _in_effect(self) -> bytes:
        content = self.part_of_a_run()
        del content["source"]
        return to_json(_sorted(content)).encode()


def load_config(
    path: Path, jobs: Mapping[str, Any] | None = None, drivers: Mapping[str, str] = DRIVERS
) -> CellConfig:
    """Read and check ``path``; every error is found in one go.

    ``jobs`` maps a job's name to a class with a ``Config`` model (default: all jobs), ``drivers`` a short
    name to ``package.module:Class``. ``FILE_MISSING``, ``FILE_UNREADABLE``, or :class:`ConfigInvalid`.
    """
    findings = Findings(str(path))
    text = _read(path)
    if _LONG_KEY.search(text):  # parsing takes time with the square of a key's parts
        raise ConfigInvalid([f"{path}: nested too deeply"])
    try:
        raw = tomllib.loads(text)
        findings.lines = locate(text)
    except RecursionError:
        raise ConfigInvalid([f"{path}: nested too deeply"]) from None
    except ValueError as exc:
        raise ConfigInvalid([f"{path}: not TOML: {exc}"]) from exc
    if _deeper_than(raw, DEEPEST):
        raise ConfigInvalid([f"{path}: nested too deeply"])
    _warn_about_owner(path, findings)
    return check_config(raw, findings, _all_jobs() if jobs is None else jobs, drivers, path)


def check_config(
    raw: dict[str, Any],
    findings: Findings,
    jobs: Mapping[str, Any],
    drivers: Mapping[str, str],
    path: Path,
) -> CellConfig:
    """Check parsed TOML; ``path`` resolves relative file names."""
    raw = put_in_place(take_out(raw, findings), findings)
    check_units(raw, findings)
    check_names(raw, findings)
    check_tools(raw, findings)
    check_contradictions(raw, findings)
    check_plausible(raw, findings)
    devices = {
        name: _check_device(name, section, findings, drivers)
        for name, section in tables(raw.get("device")).items()
    }
    _check_bindings(devices, findings, drivers)
    _check_roles(raw, devices, findings, drivers)
    targets = {
        name: _check_target(name, section, findings) for name, section in tables(raw.get("target")).items()
    }
    robot_section = raw.get("robot")
    roles = devices_by_role(robot_section if isinstance(robot_section, dict) else {}, devices)
    for name, section in tables(raw.get("job")).items():
        _check_job(name, section, findings, jobs, roles)
    check_program_after(raw, devices, roles, findings, drivers)
    known_jobs = {**jobs, **_configured_jobs(raw)}
    recipes = check_recipes(raw, known_jobs, findings)
    check_loads(raw, known_jobs, roles, findings)
    fixed = _validated(FixedSections, raw, (), findings)
    spec = robot_spec(raw, findings, path)
    observed = observed_spec(raw, devices, findings, path)
    findings.raise_if_any()
    robot = ResolvedRobot.model_construct(
        **dict(fixed.robot),
        spec=spec,
        observed_spec=observed,
        devices=devices_by_role(dict(fixed.robot), devices),
        plain_tool=has_plain_tool(raw),
        load_stated="payload_kg" in fixed.robot.model_fields_set,
    )
    sections = {key: getattr(fixed, key) for key in CellConfig.model_fields if hasattr(fixed, key)}
    return CellConfig.model_construct(
        **{**sections, "robot": robot, "device": devices, "target": targets, "recipe": recipes},
        source=str(path),
        warnings=findings.warnings,
        problems=findings.problems,
    )


@lru_cache(maxsize=64)
def device_model(config: type[BaseModel]) -> type[DeviceSection]:
    """A driver's ``Config`` together with the keys that every device has. It is kept: to make a model takes
    longer than to check a section by it."""
    bases: Any = (DeviceSection, config)
    made: type[DeviceSection] = create_model(config.__name__, __base__=bases, __doc__=config.__doc__)
    return made


def _deeper_than(value: Any, levels: int) -> bool:
    """Whether tables and arrays stand in each other more than ``levels`` times; without recursion."""
    inside = [value]
    for _ in range(levels + 1):
        inside = [
            item
            for outer in inside
            for item in (outer.values() if isinstance(outer, dict) else outer)
            if isinstance(item, dict | list)
        ]
        if not inside:
            return False
    return True


def _read(path: Path) -> str:
    try:
        if path.stat().st_size > MAX_BYTES:
            raise error("FILE_UNREADABLE", f"{path}: more than {MAX_BYTES} bytes")
        return path.read_text("utf-8-sig")  # editors on Windows write a byte order mark
    except FileNotFoundError:
        raise error("FILE_MISSING", f"{path}; 'cellward init' writes a commented one") from None
    except UnicodeDecodeError as exc:
        raise error("FILE_UNREADABLE", f"{path}: not UTF-8 text at byte {exc.start}") from exc
    except OSError as exc:
        raise error("FILE_UNREADABLE", f"{path}: {exc.strerror or exc}") from exc


def _warn_about_owner(path: Path, findings: Findings) -> None:
    if path.stat().st_mode & stat.S_IWOTH:
        findings.warn((), "everybody may write this file, which names code to import; make it root's")


def _all_jobs() -> Mapping[str, Any]:
    from procedures.registry import JOBS

    return JOBS


def _validated(
    model: type[BaseModel], raw: Mapping[str, Any], path: tuple[str, ...], findings: Findings
) -> Any:
    """The model of ``raw``, or None with findings. JSON rules: no guessing of types, lists for tuples."""
    try:
        return model.model_validate_json(to_json(raw), strict=True)
    except ValidationError as exc:
        findings.add_validation(path, raw, model, exc)
        _look_behind(model, raw, path, findings, exc)
        return None


def _look_behind(
    model: type[BaseModel], raw: Mapping[str, Any], path: tuple[str, ...], findings: Findings, first: Any
) -> None:
    """The findings that the wrong keys hide: how keys fit together is judged only where each one is right.

    So the optional keys that are wrong are left out, and the rest is looked at once more.
    """
    wrong = {item["loc"][0] for item in first.errors() if item["loc"]}
    required = {info.alias or key for key, info in model.model_fields.items() if info.is_required()}
    if not wrong or wrong & required:
        return
    try:
        model.model_validate_json(to_json({k: v for k, v in raw.items() if k not in wrong}), strict=True)
    except ValidationError as exc:
        findings.add_validation(path, raw, model, exc)


def _check_device(
    name: str, section: dict[str, Any], findings: Findings, drivers: Mapping[str, str]
) -> DeviceSection | None:
    place = ("device", name)
    driver = section.get("driver")
    if not isinstance(driver, str):
        findings.add((*place, "driver"), "is missing" if driver is None else "should be a string")
        return None
    try:
        config = driver_class(driver, drivers).Config
    except LookupError as exc:
        findings.add((*place, "driver"), str(exc.args[0]))
        return None
    checked: DeviceSection | None = _validated(device_model(config), section, place, findings)
    return checked


def _check_bindings(
    devices: Mapping[str, DeviceSection | None], findings: Findings, drivers: Mapping[str, str]
) -> None:
    """Devices that work on another one name a device that exists and is of the right kind."""
    for name, section in devices.items():
        wanted = {} if section is None else bindings(driver_class(section.driver, drivers))
        for key, protocol in wanted.items():
            other = getattr(section, key)
            place, kind = ("device", name, key), protocol.__name__.lower()
            if other not in devices:
                findings.add(place, f"there is no [device.{other}]{did_you_mean(other, devices)}")
            elif (found := devices[other]) is not None and not plays(
                driver_class(found.driver, drivers), protocol
            ):
                findings.add(place, f"[device.{other}] is no {kind}, its driver is '{found.driver}'")


def _check_roles(
    raw: Mapping[str, Any],
    devices: Mapping[str, DeviceSection | None],
    findings: Findings,
    drivers: Mapping[str, str],
) -> None:
    """A device that plays a role is of the role's kind, whether it was named for it or has its name."""
    section = raw.get("robot")
    named = section if isinstance(section, dict) else {}
    for role, name in devices_by_role(named, devices).items():
        found = devices[name]
        wanted = ROLES[role].protocol
        if found is None:
            continue
        driver = driver_class(found.driver, drivers)
        if plays(driver, wanted):
            if lacks := lacking(driver, wanted):
                what = (
                    f"driver '{found.driver}' lacks {' and '.join(lacks)}, of cell.devices.{wanted.__name__}"
                )
                findings.add(
                    ("device", name, "driver"),
                    f"{what}: install the version of its package for this Cellward",
                )
            continue
        what = f"the role '{role}' needs {ROLES[role].kind}, but [device.{name}] is {kind_of(driver)}"
        if named.get(role):
            fitting = (n for n, s in devices.items() if s and plays(driver_class(s.driver, drivers), wanted))
            known = " or ".join(f"[device.{n}]" for n in fitting)
            fix = f"name {known}" if known else "remove the key, or add a device of that kind and name it"
            findings.add(("robot", role), f"{what} (driver '{found.driver}'); {fix}")
        else:
            fix = f"give it another name, or name the device of the role in [robot] {role}"
            findings.add(("device", name), f"{what} (driver '{found.driver}'); {fix}")


def _check_target(name: str, section: dict[str, Any], findings: Findings) -> dict[str, Any]:
    kind = section.get("type")
    model = TARGETS.get(kind) if isinstance(kind, str) else None
    if model is None:
        hint = did_you_mean(kind, TARGETS) if isinstance(kind, str) else ""
        what = "is missing" if kind is None else f"there is no target type '{kind}'"
        findings.add(("target", name, "type"), f"{what}{hint or ', there is ' + ', '.join(TARGETS)}")
        return {}
    checked = _validated(model, section, ("target", name), findings)
    return checked.model_dump(mode="json", exclude_none=True) if checked is not None else {}


def _check_job(
    name: str,
    section: dict[str, Any],
    findings: Findings,
    jobs: Mapping[str, Any],
    roles: Mapping[str, str],
) -> None:
    """The job's keys; and whether there is a device for each role that it uses with them."""
    section = dict(section)
    reference = section.pop("procedure", None)
    section.pop("tool", None)  # check_tools looks at it
    if reference is not None:
        job = _outside_job(name, reference, findings, jobs)
        if job is None:
            return
        jobs = {**jobs, name: job}
    if name not in jobs:
        hint = did_you_mean(name, jobs) or f", there is {', '.join(sorted(jobs)) or 'none'}"
        findings.add(("job", name), f"there is no job '{name}'{hint}")
        return
    checked = _validated(jobs[name].Config, section, ("job", name), findings)
    for role in jobs[name](checked).uses() if checked is not None else ():
        if role not in roles:
            fix = f"add a device and name it in [robot] {role}, or remove the section"
            findings.add_problem(("job", name), f"the job needs {ROLES[role].kind} as '{role}'; {fix}")


def _configured_jobs(raw: Mapping[str, Any]) -> dict[str, Any]:
    """The jobs of other packages that ``[job.NAME] procedure`` names, as far as they could be loaded."""
    from procedures.registry import JOBS

    return {
        n: JOBS[n] for n, section in tables(raw.get("job")).items() if "procedure" in section and n in JOBS
    }


def _outside_job(name: str, reference: Any, findings: Findings, jobs: Mapping[str, Any]) -> Any:
    """The class that ``procedure`` names, made a job of this process; None with a finding."""
    from procedures.registry import SHIPPED, add_configured

    place = ("job", name, "procedure")
    if name in SHIPPED:
        findings.add(place, f"'{name}' is a shipped job; remove the key, or give your job another name")
    elif not isinstance(reference, str):
        findings.add(place, 'should be a string, "package.module:Class"')
    else:
        try:
            return add_configured(name, reference, jobs)
        except LookupError as exc:
            findings.add(place, str(exc.args[0]))
    return None


def _sorted(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _sorted(value[key]) for key in sorted(value)}
    return [_sorted(item) for item in value] if isinstance(value, list) else value
