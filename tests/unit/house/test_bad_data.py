"""Numbers that no cell has, damaged images and damaged runs: one sentence and the right exit code."""

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from bench.mutations import measure
from cell.errors import InputError
from procedures.hand_eye.solve.image_size import image_size
from procedures.hand_eye.solve.images import read_grey
from procedures.solving import within_limits
from tests.kit import hand_eye_scene, kincal_scene
from tests.kit.cli_harness import CellOnDisk, CommandLine, hand_eye_result
from tests.kit.solved import solve_hand_eye, solve_intercept, solve_kincal

Change = Callable[[dict[str, Any]], None]


def first(data: dict[str, Any]) -> dict[str, Any]:
    observation: dict[str, Any] = data["observations"][0]
    return observation


def capture(folder: Path, change: Change) -> Path:
    data = json.loads(json.dumps(hand_eye_scene.make_scene(1, count=8).data_set()))
    change(data)
    (folder / "capture.json").write_text(json.dumps(data))
    return folder


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            lambda d: first(d)["T_base_flange"].__setitem__(0, 1e308),
            "observations[0].T_base_flange[0] is beyond",
        ),
        (lambda d: first(d)["corners"][3].__setitem__(1, -1e30), "observations[0].corners[3][1] is beyond"),
        (lambda d: first(d).update(t=1e15), "observations[0].t is beyond 1e+11 s"),
        (lambda d: first(d).update(group=10**30), "observations[0].group"),
        (lambda d: d["camera"]["K"].__setitem__(0, 1e-300), "positive focal lengths"),
        (lambda d: d["camera"].update(width=2**40), "camera.width"),
        (lambda d: d["target"].update(square_m=5e-324), "square_m"),
        (lambda d: d.update(noise={"sigma_px": 1e200}), "noise.sigma_px is beyond"),
    ],
)
def test_a_number_that_no_cell_has_is_refused_by_its_name(tmp_path: Path, change: Change, words: str) -> None:
    with pytest.raises(InputError) as caught:
        solve_hand_eye(capture(tmp_path, change))
    assert caught.value.name == "DATA_INVALID"
    assert words in caught.value.detail
    assert "capture.json" in caught.value.detail


@pytest.mark.parametrize("where", ["q", "p_tracker", "link"])
def test_an_arm_or_a_sample_of_1e308_is_refused_by_its_name(tmp_path: Path, where: str) -> None:
    made = kincal_scene.make_scene("palletizer", 1, 20)
    scene = made.changed(**json.loads(json.dumps(made.data)))  # the scenes share their table of the arm
    if where == "link":
        scene.data["robot"]["parameters"]["a2"] = 1e308
    else:
        scene.data["samples"][3][where][1] = 1e308
    with pytest.raises(InputError) as caught:
        solve_kincal(scene.write(tmp_path))
    names = {"link": "parameters.a2", "q": "samples[3].q[1]", "p_tracker": "samples[3].p_tracker[1]"}
    assert names[where] in caught.value.detail


@pytest.mark.parametrize("fault", [np.linalg.LinAlgError("SVD"), OverflowError(), MemoryError("4 GB")])
def test_what_cannot_be_computed_names_the_file(fault: Exception) -> None:
    @within_limits
    def subject(path: Path) -> None:
        raise fault

    with pytest.raises(InputError, match=r"set\.json (cannot be computed with|needs more memory)"):
        subject(Path("set.json"))


def test_a_defect_of_the_program_is_not_called_a_fault_of_the_data() -> None:
    @within_limits
    def subject(path: Path) -> None:
        raise ValueError("something else")

    with pytest.raises(ValueError, match="something else"):
        subject(Path("set.json"))


@pytest.mark.parametrize("name", ["a\0b.png", "\ud800.png", "x" * 5000])
def test_what_is_no_name_of_a_file_is_refused_by_the_field(tmp_path: Path, name: str) -> None:
    def change(data: dict[str, Any]) -> None:
        del first(data)["corners"]
        first(data)["image"] = name

    with pytest.raises(InputError, match=r"no name of a file|half of a character"):
        solve_hand_eye(capture(tmp_path, change))


def huge_png(width: int, height: int) -> bytes:
    """A small file that unpacks to very many pixels."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    packer = zlib.compressobj(9)
    rows = b"".join(packer.compress(bytes(width + 1)) for _ in range(height)) + packer.flush()
    header = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", rows) + chunk(b"IEND", b"")


def test_an_image_of_another_size_is_refused_before_it_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def change(data: dict[str, Any]) -> None:
        del first(data)["corners"]
        first(data)["image"] = "huge.png"

    (tmp_path / "huge.png").write_bytes(huge_png(9000, 9000))
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    with pytest.raises(InputError, match="9000x9000 pixels, but the camera has 1280x800"):
        solve_hand_eye(capture(tmp_path, change))


def test_an_image_of_too_many_pixels_is_refused_whatever_the_camera(tmp_path: Path) -> None:
    path = tmp_path / "huge.png"
    path.write_bytes(huge_png(26000, 1)[:16] + struct.pack(">II", 26000, 26000) + bytes(20))
    with pytest.raises(InputError, match="26000x26000 pixels, more than"):
        read_grey(path, "image")


@pytest.mark.parametrize("kind", [".png", ".jpg", ".bmp", ".tiff", ".pgm", ".ppm"])
def test_the_size_in_the_header_is_that_of_the_decoded_image(kind: str) -> None:
    grey = np.random.default_rng(0).integers(0, 255, (48, 73, 3), dtype=np.uint8)
    whole, data = cv2.imencode(kind, grey if kind != ".pgm" else grey[..., 0])
    assert whole
    assert image_size(data.tobytes()) == (73, 48)
    assert all(image_size(data.tobytes()[:k]) in (None, (73, 48)) for k in range(60))


def test_a_key_that_stands_twice_is_refused(tmp_path: Path) -> None:
    path = capture(tmp_path, lambda d: None) / "capture.json"
    path.write_text(path.read_text().replace('"setup"', '"setup": "eye-to-hand", "setup"', 1))
    with pytest.raises(InputError, match="has the key 'setup' twice"):
        solve_hand_eye(tmp_path)


def test_an_answer_that_takes_long_is_not_computed_twice(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bench.intercept import make
    from procedures import timed
    from procedures.belt.solve import solver as intercept

    calls = []
    real = intercept.solve_adaptive
    monkeypatch.setattr(timed, "LONG_S", 0.0)
    monkeypatch.setattr(intercept, "solve_adaptive", lambda *a: calls.append(1) or real(*a))
    (tmp_path / "intercept.json").write_text(json.dumps(make("wrap", 3, seconds=6.0, queries=2).data))
    solve_intercept(tmp_path, calls=2)
    assert len(calls) == 1


def test_an_answer_is_computed_once_unless_its_time_is_compared(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bench.intercept import make
    from procedures import timed
    from procedures.belt.solve import solver as intercept
    from procedures.hand_eye.solve import solver as hand_eye

    calls = []
    solve_adaptive, solve = intercept.solve_adaptive, hand_eye.solve
    monkeypatch.setattr(timed, "LONG_S", np.inf)
    monkeypatch.setattr(intercept, "solve_adaptive", lambda *a: calls.append("belt") or solve_adaptive(*a))
    monkeypatch.setattr(hand_eye, "solve", lambda *a: calls.append("hand-eye") or solve(*a))
    (tmp_path / "intercept.json").write_text(json.dumps(make("wrap", 3, seconds=6.0, queries=2).data))
    intercept.solve_intercept(tmp_path)
    hand_eye.solve_hand_eye(hand_eye_scene.make_scene(2, count=12).write(tmp_path))
    assert calls == ["belt", "hand-eye"]
    hand_eye.solve_hand_eye(tmp_path, calls=2)
    assert calls[2:] == ["hand-eye"] * 2


def test_a_job_that_nobody_compares_by_its_time_computes_its_answer_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bench.intercept import make
    from procedures import timed
    from procedures.belt import prediction_check
    from procedures.belt.solve import solver as intercept
    from procedures.tracker import judging
    from procedures.tracker.solve import solver as kincal

    calls = []
    solve_adaptive, estimate = intercept.solve_adaptive, kincal._estimate
    monkeypatch.setattr(timed, "LONG_S", np.inf)
    monkeypatch.setattr(intercept, "solve_adaptive", lambda *a: calls.append("belt") or solve_adaptive(*a))
    monkeypatch.setattr(kincal, "_estimate", lambda *a: calls.append("tracker") or estimate(*a))
    monkeypatch.setattr(judging, "judged", lambda found, *_: found)
    (tmp_path / "intercept.json").write_text(json.dumps(make("wrap", 3, seconds=6.0, queries=2).data))
    picked = SimpleNamespace(changed=dict, result=SimpleNamespace(changed=dict))
    prediction_check.with_predictions(picked, tmp_path)
    judging.solve_within_limits(kincal_scene.make_scene("ur10e", 2, 40).write(tmp_path), 1.0)
    assert calls == ["belt", "tracker"]


@pytest.fixture
def cell(tmp_path: Path) -> CellOnDisk:
    found = CellOnDisk(tmp_path)
    for number in (1, 2):
        found.add_run(number, hand_eye_result(), outcome="complete", verdict="pass", error=None)
    return found


@pytest.mark.parametrize("command", ["show", "compare", "replay", "export"])
def test_a_run_whose_result_is_damaged_inside_is_a_sentence(
    cell: CellOnDisk,
    command: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (folder,) = (cell.state / "runs").glob("*_2")
    result = json.loads((folder / "result.json").read_text())
    result["result"]["T_flange_camera"] = [1, "x"]
    result["inputs"] = 7
    (folder / "result.json").write_text(json.dumps(result))
    (folder / "capture.json").write_text("{}")
    words: dict[str, tuple[object, ...]] = {
        "compare": ("compare", 1, 2),
        "export": ("export", folder / "result.json", "--format", "ros"),
    }
    subject = CommandLine(monkeypatch, capsys, cell.config)(*words.get(command, (command, 2)))
    assert subject.code == 2, subject
    assert "Error 400" in subject.err
    assert str(folder.parent) in subject.err or "T_flange_camera" in subject.err


@pytest.mark.parametrize(
    "kind", ["kincal", "ROBOT", "hand-eye images", "run: show", "run: compare", "run: export"]
)
def test_mutated_files_end_with_a_sentence_and_the_right_code(kind: str, tmp_path: Path) -> None:
    ((_, subject),) = measure(8, 7, tmp_path, (kind,))
    assert subject.faults == []
    assert subject.nonsense == []
    assert sum(subject.codes.values()) == 8


@pytest.mark.parametrize("kind", ["control requests", "modbus requests"])
def test_damaged_requests_to_the_daemon_are_refused_or_answered_and_the_next_one_too(
    kind: str, tmp_path: Path
) -> None:
    ((_, subject),) = measure(40, 7, tmp_path, (kind,))
    assert subject.faults == []
    assert sum(subject.codes.values()) == 40
    assert {0, 2} <= set(subject.codes)


def test_a_defect_that_a_damaged_request_finds_is_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("daemon.start_needs.make_procedure", lambda cls, config, params, recipe: {}[cls])
    ((_, subject),) = measure(40, 7, tmp_path, ("control requests",))
    assert any("INTERNAL" in fault for fault in subject.faults)
    assert any("traceback" in fault for fault in subject.faults)
