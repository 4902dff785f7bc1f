"""Requests that are malformed, too large or mutated are each answered by the control socket."""

import json
import random
import re
import socket
from pathlib import Path
from typing import Any

import pytest

from bench._mutate import NUMBERS, OTHERS
from tests.kit.control_harness import RecordingEngine
from tests.kit.control_serving import engine, path, serving

__all__ = ["engine", "path"]


@pytest.mark.parametrize(
    ("request_line", "told"),
    [
        (b"{]\n", "not JSON"),
        (b"[1]\n", "not an object"),
        (b'{"id": 1, "method": "explode"}\n', "no method 'explode'"),
        (b'{"id": 1, "method": "confirm"}\n', "needs 'prompt_id'"),
        (b'{"id": 1, "method": "confirm", "params": {"prompt_id": "7"}}\n', "'prompt_id' is not of type int"),
        (b'{"id": 1, "method": "confirm", "params": {"prompt_id": true}}\n', "is not of type int"),
        (b'{"id": 1, "method": "start", "params": [1]}\n', "not an object"),
        (b"x" * (1 << 20) + b"xxx\n", "longer than"),
    ],
)
def test_a_malformed_request_is_refused_in_a_sentence(
    engine: RecordingEngine, path: Path, request_line: bytes, told: str
) -> None:
    def use() -> dict[str, Any]:
        with socket.socket(socket.AF_UNIX) as raw:
            raw.settimeout(5)
            raw.connect(str(path))
            raw.sendall(request_line)
            with raw.makefile("rb") as lines:
                return json.loads(lines.readline())

    reply = serving(path, engine, use)
    assert reply["error"]["name"] == "ARGUMENT_INVALID"
    assert told in reply["error"]["text"]


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"[" * 100_000 + b"]" * 100_000, "nested deeper"),
        (b'{"method": "accept", "params": {"result_id": 9223372036854775808}}', "beyond 2\\*\\*63"),
        (b'{"method": "accept", "params": {"result_id": 1e999}}', "beyond 2\\*\\*63"),
        (b'{"method": "rollback", "params": {"name": "\\ud800"}}', "not valid Unicode"),
        (b'{"method": "start", "params": ' + b'{"a": ' * 20 + b"1" + b"}" * 20 + b"}", "nested deeper"),
    ],
)
def test_a_request_beyond_the_bounds_is_refused_by_a_sentence(
    engine: RecordingEngine, path: Path, line: bytes, why: str
) -> None:
    def use() -> dict[str, Any]:
        with socket.socket(socket.AF_UNIX) as subject:
            subject.connect(str(path))
            subject.sendall(line + b"\n")
            answer: dict[str, Any] = json.loads(subject.makefile().readline())
            return answer["error"]

    told = serving(path, engine, use)
    assert told["name"] == "ARGUMENT_INVALID"
    assert re.search(why, told["text"])


def _mutated(rng: random.Random) -> bytes:
    """A request with one or more of its parts replaced, lost or doubled, or with its bytes damaged."""
    method, params = rng.choice(
        [
            ("start", {"job": "cone-capture", "params": {"settle_s": "0.5"}, "adopt": 3, "dry_run": True}),
            ("confirm", {"prompt_id": 65537}),
            ("accept", {"result_id": 4, "warned": True}),
            ("reject", {"result_id": 5, "why": "board was loose"}),
            ("rollback", {"name": "T_flange_camera"}),
            ("live", {"since": {"speed": 3}}),
            ("halt", {}),
        ]
    )
    request: dict[str, Any] = {"id": 1, "method": method, "params": params}
    for _ in range(rng.randrange(1, 4)):
        part: Any = rng.choice([request, request.get("params"), request.get("params")])
        if not isinstance(part, dict):
            continue
        key = rng.choice([*part, "unknown"])
        if rng.random() < 0.2:
            part.pop(key, None)
        else:
            part[key] = rng.choice([*NUMBERS, *OTHERS])
    line = json.dumps(request).encode()
    if rng.random() < 0.3:
        at = rng.randrange(len(line))
        line = line[:at] + bytes([rng.randrange(256)]) + line[at + rng.randrange(3) :]
    return line.replace(b"\n", b" ") + b"\n"


@pytest.mark.parametrize("seed", range(4))
def test_mutated_requests_are_each_answered_and_never_by_an_internal_error(
    engine: RecordingEngine, path: Path, seed: int, caplog: pytest.LogCaptureFixture
) -> None:
    lines: list[tuple[str, str, bool, str]] = []

    def use() -> list[tuple[bytes, dict[str, Any]]]:
        rng = random.Random(seed)
        answered = []
        with socket.socket(socket.AF_UNIX) as subject:
            subject.settimeout(5.0)
            subject.connect(str(path))
            answers = subject.makefile()
            for _ in range(500):
                line = _mutated(rng)
                if b'"watch"' in line:
                    continue
                subject.sendall(line)
                answered.append((line, json.loads(answers.readline())))
        return answered

    answered = serving(path, engine, use, lambda *line: lines.append(line))
    assert len(answered) == 500
    for line, answer in answered:
        assert ("result" in answer) != ("error" in answer), line
        assert (answer.get("error") or {}).get("name") != "INTERNAL", (line, answer)
    assert {"result", "error"} <= {key for _, answer in answered for key in answer}
    assert all(len(text) < 600 for line in lines for text in (line[1], line[3]))
    assert not [record for record in caplog.records if record.exc_info]
