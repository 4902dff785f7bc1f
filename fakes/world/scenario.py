"""A scenario: what the twin's world truly is, where its fakes listen, and which faults happen when."""

import copy
import difflib
import inspect
import json
import tomllib
from collections.abc import Mapping
from functools import lru_cache
from importlib.resources import files
from itertools import takewhile
from pathlib import Path
from typing import Annotated, Any, Literal, Self, get_args

from pydantic import BaseModel, Field, ValidationError, model_validator

from cell.errors import error
from cell.formats.reading import Strict
from fakes.world.arm.truth import ArmTruth, Six, ToolTruth
from fakes.world.beams.truth import BeamTruth, Channel, IoTruth
from fakes.world.belt.item_truth import GripperTruth, ItemsTruth, PlaceTruth
from fakes.world.belt.truth import BeltTruth
from fakes.world.camera.truth import CameraTruth, Placement, PrintTruth
from fakes.world.obstacle import Obstacle
from fakes.world.palletizer.truth import ObservedTruth
from fakes.world.rack.truth import RackTruth
from fakes.world.toml_text import to_toml
from fakes.world.tracker.lines_form import LinesForm
from fakes.world.tracker.truth import ReflectorTruth, TrackerTruth

SCHEMA = "cellward.scenario/1"
OBSERVED, OBSERVED_MODEL = "palletizer", "palletizer.json"
ROBOT_FILE = "robot.json"
IDEAL_SUFFIX = ":ideal"
IDEAL: Mapping[str, tuple[str, ...]] = {  # keys that an ideal world leaves out; see left_out
    "": ("target_print",),
    "arm": ("servo", "reported", "joint_errors", "error"),
    "tool": ("lean_rad",),
    "observed": ("joint_errors",),
    "camera": (
        "told",
        "noise_px",
        "row_time_s",
        "stamp_jitter_s",
        "stamp_late_s",
        "stereo",
        "vignette",
        "noise_grey",
        "blur_px",
        "autofocus",
        "auto_exposure",
    ),
    "io": ("filter_s", "scan_s"),
    "place": ("filter_s", "scan_s"),
    "belt": ("late_s", "jitter_s", "by_events"),
    "gripper": ("close_s", "open_s"),
}


class WorldTruth(Strict):
    """``[world]``."""

    ideal: bool = Field(
        default=False,
        description="a kinder world than any cell: what IDEAL lists is left out, whatever the scenario says",
    )
    seed: int = Field(default=1, ge=0)
    arm: ArmTruth
    tool: ToolTruth = ToolTruth()
    camera: CameraTruth | None = None
    target: dict[str, Any] | None = Field(default=None, description="as designed, and as the config has it")
    target_print: PrintTruth = Field(default=PrintTruth(), description="how the target differs from that")
    placement: list[Placement] = Field(default=[])
    beams: dict[str, BeamTruth] = Field(default={}, description="usual names are xs, along x, and ys")
    io: IoTruth | None = None
    arm_inputs: dict[str, Annotated[Channel, Field(le=17)]] = Field(
        default={}, description="the arm's own digital input of each beam"
    )
    obstacle: list[Obstacle] = Field(default=[])
    belt: BeltTruth | None = None
    items: ItemsTruth | None = None
    gripper: GripperTruth | None = None
    place: PlaceTruth | None = None
    rack: RackTruth | None = Field(default=None, description="slots and parts; not beside items of a belt")
    observed: ObservedTruth | None = Field(default=None, description="an arm that its own program moves")
    tracker: TrackerTruth | None = None
    reflectors: dict[str, ReflectorTruth] = Field(
        default={}, description="on an arm, or monuments on the base; all of them are there at once"
    )

    def devices(self) -> dict[str, BaseModel | None]:
        """The truth of each device by its name in a cell.toml; None for one that this world lacks."""
        return {
            "arm": self.arm,
            "camera": self.camera,
            "beams": self.io,
            "tracker": self.tracker,
            OBSERVED: self.observed,
            "belt": self.belt,
            "gripper": self.gripper,
            "place_inputs": self.place,
        }

    @property
    def eye_in_hand(self) -> bool:
        return self.camera is not None and self.camera.T_flange_camera is not None

    @property
    def camera_mount(self) -> list[float]:
        """The camera's true pose in what carries it: the flange, or the base."""
        camera = self.camera
        return [] if camera is None else camera.T_flange_camera or camera.T_base_camera or []

    @property
    def target_mounts(self) -> list[list[float]]:
        """The target's true poses in what carries it: the base, or the flange."""
        return [p.T_base_target or p.T_flange_target or [] for p in self.placement]

    @model_validator(mode="before")
    @classmethod
    def _perhaps_ideal(cls, tables: Any) -> Any:
        return _kinder(tables) if isinstance(tables, dict) and tables.get("ideal") is True else tables

    @model_validator(mode="after")
    def _camera_and_target_come_together(self) -> Self:
        given = [self.camera is not None, self.target is not None, bool(self.placement)]
        if any(given) and not all(given):
            raise ValueError("camera, target and placement belong together: give all of them, or none")
        return self

    @model_validator(mode="after")
    def _a_print_is_of_a_target(self) -> Self:
        if self.target is None and self.target_print != PrintTruth():
            raise ValueError("target_print says how a target is printed: give [world.target] too")
        return self

    @model_validator(mode="after")
    def _only_beams_are_wired(self) -> Self:
        wired = set(self.arm_inputs) | set(self.io.inputs if self.io is not None else ())
        if strange := sorted(wired - set(self.beams)):
            raise ValueError(f"{', '.join(strange)} is wired to an input, but is not among the beams")
        return self

    @model_validator(mode="after")
    def _reflectors_have_a_tracker(self) -> Self:
        if self.reflectors and self.tracker is None:
            raise ValueError("reflectors are there for a tracker: give [world.tracker] too")
        if self.observed is None and any(r.on == "observed" for r in self.reflectors.values()):
            raise ValueError('a reflector is on = "observed", but there is no [world.observed]')
        return self

    @model_validator(mode="after")
    def _items_lie_on_a_belt(self) -> Self:
        if self.items is not None and self.belt is None:
            raise ValueError("items lie on a belt: give [world.belt] too")
        return self

    @model_validator(mode="after")
    def _a_gripper_puts_items_on_a_place(self) -> Self:
        if self.place is not None and self.gripper is None:
            raise ValueError("a gripper puts items on the place: give [world.gripper] too")
        return self

    @model_validator(mode="after")
    def _one_kind_of_things_to_take(self) -> Self:
        if self.items is not None and self.rack is not None:
            raise ValueError("a gripper takes items of a belt or parts of a rack: give one of the two")
        return self

    @model_validator(mode="after")
    def _placements_fit_the_setup(self) -> Self:
        if self.camera is None:
            return self
        wanted, other = ("T_base_target", "T_flange_target")[:: 1 if self.eye_in_hand else -1]
        for i, placement in enumerate(self.placement):
            if getattr(placement, wanted) is None or getattr(placement, other) is not None:
                raise ValueError(f"placement {i} needs {wanted}, and only that, with this camera mounting")
        return self


class FakeAddresses(Strict):
    """``[fakes]``: where the wire face listens. Loopback only: the twin is not for a network."""

    bind: str = Field(default="127.0.0.2", pattern=r"^127\.\d+\.\d+\.\d+$")
    frames_socket: str = "frames.sock"
    io_port: int = Field(default=5502, ge=1024, le=65535, description="the input module's Modbus TCP port")
    io_rtu: bool = Field(default=False, description="the input module also on a serial line, io.tty")
    io_delay_s: float = Field(default=0.001, ge=0, le=1, description="the module's shortest reply time")
    io_jitter_s: float = Field(default=0.001, ge=0, le=1, description="and what chance adds to it at most")
    tracker_port: int = Field(default=1212, ge=1024, le=65535, description="TCP port of GeoCOM")
    tracker_by: Literal["tcp", "serial"] = Field(
        default="tcp", description="the wire that the generated cell.toml names; tracker.tty is the other"
    )
    tracker_delay_s: float = Field(default=0.005, ge=0, le=1, description="its shortest reply time")
    tracker_lines: LinesForm | None = Field(default=None, description="points as lines of text as well")
    can: Literal["slcan", "socketcand"] = Field(
        default="slcan", description="the adapter that the generated cell.toml names; both are there"
    )
    can_port: int = Field(default=29536, ge=1024, le=65535, description="TCP port of the CAN gateway")
    observed_port: int = Field(
        default=5503, ge=1024, le=65535, description="Modbus TCP port of the observed arm's controller"
    )
    gripper_by: Literal["arm", "modbus", "robotiq-rtu", "robotiq-urcap"] = Field(
        default="arm", description="what moves the gripper: outputs of the arm, of a module, or its own link"
    )
    gripper_port: int = Field(
        default=5504, ge=1024, le=65535, description="TCP port of a gripper with a link of its own"
    )
    place_port: int = Field(
        default=5505, ge=1024, le=65535, description="Modbus TCP port of the input of [world.place]"
    )
    observed_by: Literal["registers", "file"] = Field(
        default="registers", description="file: the arm's program appends each rest to joints.csv instead"
    )


class FaultEntry(Strict):
    """``[[fault]]``: ``kind`` happens to ``device`` ``when_s`` seconds after the twin's start."""

    device: Literal["arm", "camera", "beams", "tracker", "palletizer", "belt", "place_inputs"]
    kind: str
    when_s: float = Field(ge=0)
    args: dict[str, Any] = Field(default={})


class CellSettings(Strict):
    """``[cell]``: what the generated cell.toml says beyond the truth."""

    name: str = "twin"
    T_flange_target_nominal: Six | None = Field(
        default=None, description="eye-to-hand: the nominal pose of the first mounting of the target"
    )
    belt_nominal: dict[str, Any] | None = Field(
        default=None, description="nominal scale and direction of the belt"
    )
    poses: dict[str, Six] = Field(default={})
    limits: dict[str, Any] = Field(
        default={
            "speed_m_s": 0.25,
            "accel_m_s2": 0.5,
            "joint_speed_rad_s": 0.8,
            "workspace": [{"min": [-1.3, -1.3, 0.0], "max": [1.3, 1.3, 1.6]}],
        }
    )
    job: dict[str, dict[str, Any]] = Field(default={})


class Scenario(Strict):
    """A whole scenario file."""

    schema_: Literal["cellward.scenario/1"] = Field(alias="schema")
    world: WorldTruth
    fakes: FakeAddresses = FakeAddresses()
    operator: Literal["manual", "auto"] = "manual"  # auto: moves the target on when a job gives the arm back
    fault: list[FaultEntry] = Field(default=[])
    cell: CellSettings = CellSettings()

    @classmethod
    def load(cls, path: str | Path) -> "Scenario":
        """Read a scenario file; a bare name like ``hand_eye`` is one of the shipped scenarios.

        ``hand_eye:ideal`` is the same cell in an ideal world; so is ``file.toml:ideal``.
        """
        given = str(path)
        ideal, path = given.endswith(IDEAL_SUFFIX), given.removesuffix(IDEAL_SUFFIX)
        source = Path(path)
        shipped = files("fakes").joinpath("scenarios", f"{path}.toml")
        if not source.suffix and shipped.is_file():
            text = shipped.read_text("utf-8")
        elif source.is_file():
            text = source.read_text("utf-8")
        else:
            known = ", ".join(shipped_scenarios())
            raise error("FILE_MISSING", f"scenario {path} is neither a file nor a shipped scenario ({known})")
        return cls.parse(text, path, ideal)

    @classmethod
    def parse(cls, text: str, name: str = "scenario", ideal: bool = False) -> "Scenario":
        """Parse and check TOML text, as an ideal world on request; ``CONFIG_INVALID`` lists every finding.

        With ``like`` it says only what differs from that shipped scenario.
        """
        try:
            tables = _whole(_tables(text), name)
            if ideal and isinstance(tables.get("world"), dict):
                tables["world"] = _kinder(tables["world"])
            return cls.model_validate(tables)
        except tomllib.TOMLDecodeError as exc:
            raise error("CONFIG_INVALID", f"{name} is not TOML: {exc}") from exc
        except ValidationError as exc:
            raise error("CONFIG_INVALID", f"{name}: " + "; ".join(_findings(exc))) from exc

    def cell_toml(
        self,
        devices: Mapping[str, Mapping[str, Any]],
        state_dir: str,
        control_socket: str,
        modbus: dict[str, Any] | None = None,
        overrides: dict[str, Any] | None = None,
        clock: str | None = None,
    ) -> str:
        """A ready cell.toml for this twin, as docs/config.md describes it.

        ``devices`` are the device tables by name, driver and address included; those of devices that the
        scenario lacks are left out. The files that ``model`` and ``observed_model`` may name are written by
        :meth:`write_robots`. ``modbus`` is its section; ``overrides`` are further top-level tables
        that replace generated ones of the same name; ``clock`` names the virtual clock of the object face.
        """
        world, robot, tables_of_devices = self.world, dict[str, Any](), dict[str, dict[str, Any]]()
        for name, truth in world.devices().items():
            if truth is None or name not in devices:
                continue
            serial = getattr(truth, "serial", None)
            tables_of_devices[name] = {**devices[name], **({"expect_serial": serial} if serial else {})}
            robot |= self._robot_keys(name)
        robot |= {
            "T_flange_target_nominal": self.cell.T_flange_target_nominal,
            "belt_nominal": self.cell.belt_nominal,
            "model": world.arm.model if world.arm.robot is None else ROBOT_FILE,
            "payload_kg": world.tool.payload_kg,
            "tool": world.tool.model_dump(include={"name", "T_flange_tool", "radius_m"}),
        }
        tables: dict[str, Any] = {
            "schema": 1,
            "cell": {
                "name": self.cell.name,
                "twin": True,
                "state_dir": state_dir,
                "control_socket": control_socket,
                "clock": clock,
            },
            "robot": robot,
            "limits": self.cell.limits,
            "poses": self.cell.poses or {"home": world.arm.q_start},
            "device": tables_of_devices,
        }
        if world.target is not None:
            tables["target"] = {"board": world.target}
        if modbus is not None:
            tables["modbus"] = modbus
        if self.cell.job:
            tables["job"] = self.cell.job
        return to_toml({**tables, **(overrides or {})})

    def _robot_keys(self, name: str) -> dict[str, Any]:
        """What ``[robot]`` says of the device: its role, and its nominal values."""
        world = self.world
        if name == OBSERVED:
            return {"observed_arm": OBSERVED, "observed_model": OBSERVED_MODEL}
        if name != "camera" or world.camera is None:
            return {name: name}
        role, mount = ("flange_camera", "flange") if world.eye_in_hand else ("fixed_camera", "base")
        return {role: "camera", f"T_{mount}_camera_nominal": world.camera.nominal}

    def write_robots(self, folder: Path) -> None:
        """Write the ROBOTs that the cell.toml names as files beside it."""
        if self.world.arm.robot is not None:
            (folder / ROBOT_FILE).write_text(json.dumps(self.world.arm.robot, indent=1), "utf-8")
        if self.world.observed is not None:
            (folder / OBSERVED_MODEL).write_text(json.dumps(self.world.observed.robot, indent=1), "utf-8")


def _whole(tables: dict[str, Any], name: str) -> dict[str, Any]:
    """``tables`` of the scenario ``name``, over those of the shipped one that they are ``like``, if any."""
    if (like := tables.pop("like", None)) is None:
        return tables
    known = [other for other in shipped_scenarios() if other != name]
    if like not in known:
        raise error(
            "CONFIG_INVALID", f"{name}: like = {like!r} is not a shipped scenario: {', '.join(known)}"
        )
    text = files("fakes").joinpath("scenarios", f"{like}.toml").read_text("utf-8")
    return _changed(_whole(_tables(text), like), tables)


def _tables(text: str) -> dict[str, Any]:
    """What the TOML ``text`` says, for the caller to change.

    Who makes cell after cell reads the same scenario each time, and parsing takes most of that.
    """
    return copy.deepcopy(_parsed(text))


@lru_cache(maxsize=32)
def _parsed(text: str) -> dict[str, Any]:
    return tomllib.loads(text)


def _changed(tables: Mapping[str, Any], by: Mapping[str, Any]) -> dict[str, Any]:
    """``tables`` with what ``by`` says otherwise, at every depth."""
    both = {
        key: _changed(tables[key], value)
        if isinstance(tables.get(key), dict) and isinstance(value, dict)
        else value
        for key, value in by.items()
    }
    return {**tables, **both}


def left_out(world: Mapping[str, Any]) -> dict[str, tuple[str, ...]]:
    """The keys that the ideal world of ``world`` leaves out, by table; those of ``world`` itself under "".

    Links that a tracker measures keep their error: it is what the tracker is there to find.
    """
    if "tracker" not in world:
        return dict(IDEAL)
    return {**IDEAL, "arm": tuple(key for key in IDEAL["arm"] if key != "error")}


def _kinder(world: Mapping[str, Any]) -> dict[str, Any]:
    """The tables of a world without what an ideal one leaves out."""
    unkind = left_out(world)
    kinder = {
        name: {key: value for key, value in world[name].items() if key not in keys}
        for name, keys in unkind.items()
        if isinstance(world.get(name), dict)
    }
    return {**{key: value for key, value in world.items() if key not in unkind[""]}, **kinder}


def _findings(exc: ValidationError) -> list[str]:
    """One sentence a finding, with the place, and the nearest known key for an unknown one."""
    out = []
    for item in exc.errors():
        where = ".".join(str(p) for p in item["loc"])
        if item["type"] == "extra_forbidden":
            near = difflib.get_close_matches(str(item["loc"][-1]), _known_keys(), n=1)
            out.append(f"{where} is not a known key" + (f", did you mean {near[0]}?" if near else ""))
        else:
            out.append(f"{where}: {item['msg']}")
    return out


def _known_keys() -> set[str]:
    """The keys of all tables of a scenario, at every depth."""
    keys, seen = set[str](), set[Any]()
    todo: list[Any] = [Scenario]
    while todo:
        kind: Any = todo.pop()
        todo += get_args(kind)
        if not inspect.isclass(kind) or not issubclass(kind, BaseModel) or kind in seen:
            continue
        seen.add(kind)
        for name, info in kind.model_fields.items():
            keys.add(info.alias or name)
            todo.append(info.annotation)
    return keys


def shipped_descriptions() -> dict[str, str]:
    """What each shipped scenario is, by name: the sentences that its file begins with."""
    texts = {name: files("fakes").joinpath("scenarios", f"{name}.toml") for name in shipped_scenarios()}
    said = {}
    for name, file in texts.items():
        head = takewhile(lambda line: line.startswith("#"), file.read_text("utf-8").splitlines())
        said[name] = " ".join(line.removeprefix("#").strip() for line in head)
    return said


def shipped_scenarios() -> list[str]:
    """The names that ``load`` takes without a folder."""
    found = files("fakes").joinpath("scenarios").iterdir()
    return sorted(entry.name.removesuffix(".toml") for entry in found if entry.name.endswith(".toml"))
