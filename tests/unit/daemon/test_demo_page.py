"""The demo's page: on a free port, and never in the way of the demo."""

import socket
import tomllib
from pathlib import Path

import pytest

from daemon.config.faces import HttpSection
from daemon.demo.page import HOST, DemoPage


def taken() -> socket.socket:
    listener = socket.socket()
    listener.bind((HOST, 0))
    listener.listen()
    return listener


def test_where_the_usual_port_is_taken_the_page_has_another_one(monkeypatch: pytest.MonkeyPatch) -> None:
    with taken() as listener:
        port = listener.getsockname()[1]
        monkeypatch.setattr("daemon.demo.page.PORT", port)
        subject = DemoPage.on_a_free_port()
    assert subject.port not in (0, port)
    assert f":{subject.port}/" in subject.address


def test_the_twins_configuration_gets_a_page_that_all_may_watch_and_one_may_use(tmp_path: Path) -> None:
    path = tmp_path / "cell.toml"
    path.write_text("schema = 1\n[cell]\nname = 'x'\n")
    DemoPage.on_a_free_port().add_to(path)
    subject = HttpSection.model_validate(tomllib.loads(path.read_text())["http"])
    assert subject.look_without_login
    assert [user.role for user in subject.user.values()] == ["integrator"]


def test_a_port_that_was_taken_meanwhile_costs_the_page_and_not_the_demo(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cell.toml"
    path.write_text("schema = 1\n")
    with taken() as listener:
        DemoPage(listener.getsockname()[1], "T").add_to(path)
    assert path.read_text() == "schema = 1\n"
    assert "no page for this twin" in capsys.readouterr().err
