"""``cellward install`` below a scratch root: files, networks, versions; judged by systemd's own tools."""

import os
import re
import shutil
import subprocess
from pathlib import Path

import pytest

from cell.errors import CellError
from daemon.config import CellConfig, init_text, load_config
from daemon.service import install as service
from daemon.service.network import drop_in, not_permitted, subnets
from daemon.service.places import CONFIG, NETWORK, OF_ADMINISTRATOR, OF_PACKAGE, PROGRAMS
from daemon.service.program import CURRENT, refuse_older, wheel_version
from tests.kit.cli_harness import CellOnDisk, CommandLine

needs_systemd = pytest.mark.skipif(
    any(shutil.which(tool) is None for tool in ("systemd-sysusers", "systemd-tmpfiles", "systemd-analyze")),
    reason="the tools of systemd are not installed",
)


def config_with(tmp_path: Path, **changes: str) -> CellConfig:
    """The example with each change, "before => after"."""
    text = init_text()
    for change in changes.values():
        old, _, new = change.partition(" => ")
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "cell.toml"
    path.write_text(text)
    return load_config(path)


def root_with_program(tmp_path: Path, version: str = "0.1.0") -> Path:
    """A root in which a program stands already, as a wheelhouse would have made it."""
    root = tmp_path / "root"
    (root / PROGRAMS / version / "bin").mkdir(parents=True)
    (root / PROGRAMS / CURRENT).symlink_to(version)
    (root / "etc").mkdir()
    (root / "etc/passwd").write_text("root:x:0:0::/:/bin/sh\n")
    (root / "etc/group").write_text("root:x:0:\n")
    return root


def test_the_networks_are_those_of_the_addresses(tmp_path: Path) -> None:
    config = config_with(
        tmp_path,
        arm='host = "192.168.10.20" => host = "10.0.5.20"',
        modbus='bind = "127.0.0.1:5020" => bind = "0.0.0.0:5020"',
        clients='allow_clients = [] => allow_clients = ["10.7.0.0/16", "10.0.5.9", "127.0.0.1"]',
    )
    assert list(map(str, subnets(config))) == ["10.0.5.0/24", "10.7.0.0/16"]
    assert list(map(str, subnets(config, ["fd00::/64"])))[-1] == "fd00::/64"
    assert "IPAddressAllow=\nIPAddressAllow=localhost 10.0.5.0/24 10.7.0.0/16\n" in drop_in(subnets(config))


def test_the_network_of_a_camera_is_that_of_its_address(tmp_path: Path) -> None:
    camera = 'source = "oak"                            # or => host = "169.254.1.222"  # or'
    assert list(map(str, subnets(config_with(tmp_path, camera=camera)))) == [
        "169.254.1.0/24",
        "192.168.10.0/24",
    ]


def test_what_has_no_address_is_asked_for(tmp_path: Path) -> None:
    named = config_with(tmp_path, arm='host = "192.168.10.20" => host = "robot-3"')
    with pytest.raises(CellError, match=r"device\.arm\.host = 'robot-3' is a name"):
        subnets(named)
    assert list(map(str, subnets(named, ["10.9.0.0/24"]))) == ["10.9.0.0/24"]
    open_to_all = config_with(tmp_path, modbus='bind = "127.0.0.1:5020" => bind = "0.0.0.0:5020"')
    with pytest.raises(CellError, match=r"modbus\.bind = '0\.0\.0\.0' serves every address"):
        subnets(open_to_all)
    with pytest.raises(CellError, match="no network"):
        subnets(named, ["10.9.0"])


@needs_systemd
def test_a_scratch_root_gets_all_of_it_and_gives_it_back_but_the_data(tmp_path: Path) -> None:
    root = root_with_program(tmp_path)
    (root / CONFIG).parent.mkdir(parents=True)
    (root / CONFIG).write_text(init_text())
    if os.geteuid() != 0:
        pytest.skip("folders are given to another user, which only root may do")
    done = service.install(
        root, None, Path("/usr/bin/python3"), ".TH CELLWARD 1\n", load_config(root / CONFIG), []
    )
    assert "the service may reach 192.168.10.0/24" in done.did
    unit = (root / OF_ADMINISTRATOR.units / "cellward.service").read_text()
    assert f"ExecStart=/{PROGRAMS / CURRENT}/bin/cellward run" in unit
    assert os.readlink(root / "usr/local/bin/cellward") == "/opt/cellward/current/bin/cellward"
    assert re.search(r"(?m)^cellward:", (root / "etc/passwd").read_text())
    assert (root / "var/lib/cellward/runs").stat().st_mode & 0o777 == 0o750
    assert (root / CONFIG).stat().st_mode & 0o777 == 0o640
    run = root / "var/lib/cellward/runs/20260101T000000Z_cone-capture_1"
    run.mkdir()
    again = service.install(
        root, None, Path("/usr/bin/python3"), ".TH CELLWARD 1\n", load_config(root / CONFIG), []
    )
    assert again.did == done.did
    kept = service.uninstall(root)
    assert any("/var/lib/cellward are kept" in sentence for sentence in kept.left)
    assert run.is_dir()
    assert (root / CONFIG).is_file()
    users = re.compile(r"etc/(\.pwd\.lock|g?shadow-?|group-?|passwd-?)")
    left = [str(p.relative_to(root)) for p in root.rglob("*") if not p.is_dir()]
    assert [path for path in left if not users.fullmatch(path)] == [str(CONFIG)]
    with pytest.raises(CellError, match="not installed"):
        service.uninstall(root)


@needs_systemd
def test_the_unit_with_its_networks_is_verified_and_as_little_exposed(tmp_path: Path) -> None:
    unit = tmp_path / "cellward.service"
    text = OF_ADMINISTRATOR.files()[OF_ADMINISTRATOR.units / "cellward.service"]
    unit.write_text(re.sub(r"(?m)^ExecStart=\S+", "ExecStart=/bin/true", text))
    folder = tmp_path / "cellward.service.d"
    folder.mkdir()
    (folder / NETWORK.name).write_text(drop_in(subnets(config_with(tmp_path), ["10.0.5.0/24"])))
    for words in (("verify", "--man=no"), ("security", "--offline=true", "--threshold=20", "--no-pager")):
        done = subprocess.run(
            ["systemd-analyze", *words, str(unit)], capture_output=True, text=True, timeout=60, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
        if words[0] == "verify":
            assert (done.stdout, done.stderr) == ("", "")


def test_an_address_that_the_service_may_not_reach_is_said(tmp_path: Path) -> None:
    config = config_with(tmp_path)
    root = tmp_path / "root"
    assert not_permitted(config, root) == [], "no service is installed there"
    unit = root / OF_PACKAGE.units / "cellward.service"
    unit.parent.mkdir(parents=True)
    unit.write_text("[Unit]\n")
    (said,) = not_permitted(config, root)
    assert said.startswith("device.arm.host: the service may not reach 192.168.10.20")
    (root / NETWORK).parent.mkdir(parents=True)
    (root / NETWORK).write_text(drop_in(subnets(config)))
    assert not_permitted(config, root) == []


def test_an_older_program_is_refused_in_words(tmp_path: Path) -> None:
    with pytest.raises(CellError, match=r"cellward 0\.10\.0 is installed and 0\.9\.1 is older"):
        refuse_older("0.9.1", "0.10.0")
    refuse_older("0.10.1", "0.10.0")
    refuse_older("0.1.0", None)
    house = tmp_path / "wheels"
    house.mkdir()
    with pytest.raises(CellError, match="0 wheels of cellward"):
        wheel_version(house)
    (house / "cellward-0.2.0-py3-none-any.whl").touch()
    assert wheel_version(house) == "0.2.0"


def test_a_package_keeps_what_is_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    root = tmp_path / "root"
    unit = root / OF_PACKAGE.units / "cellward.service"
    unit.parent.mkdir(parents=True)
    unit.write_text("[Unit]\n")
    subject = CommandLine(monkeypatch, capsys, CellOnDisk(tmp_path).config)
    done = subject("uninstall", "--root", root)
    assert done.code == 4
    assert "apt remove cellward" in done.err
    assert subject("install", "--root", tmp_path / "absent").code == 2
