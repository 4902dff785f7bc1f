"""What goes into /etc and /usr/lib: judged by systemd's own tools against a scratch root."""

import json
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

from cell import priority
from daemon.cli.failures import BAD_INPUT, REFUSED
from daemon.demo.children import SERVICE_NICE

ROOT = Path(__file__).parents[3]
DEPLOY = ROOT / "daemon/service/files"


def needs(tool: str) -> pytest.MarkDecorator:
    return pytest.mark.skipif(shutil.which(tool) is None, reason=f"{tool} is not installed (systemd)")


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


@pytest.fixture
def subject(tmp_path: Path) -> Path:
    """The unit with a binary that exists here in place of the installed one."""
    text = (DEPLOY / "cellward.service").read_text("utf-8")
    unit = tmp_path / "cellward.service"
    unit.write_text(re.sub(r"(?m)^ExecStart=\S+", "ExecStart=/bin/true", text))
    return unit


@needs("systemd-analyze")
def test_systemd_finds_nothing_to_say_about_the_unit(subject: Path) -> None:
    """Unknown keys are only warnings with exit code 0, so silence is asked for as well."""
    done = run("systemd-analyze", "verify", "--man=no", str(subject))
    assert (done.returncode, done.stderr, done.stdout) == (0, "", "")


@needs("systemd-analyze")
def test_the_exposure_is_at_most_2_of_10(subject: Path) -> None:
    done = run("systemd-analyze", "security", "--offline=true", "--threshold=20", "--no-pager", str(subject))
    assert done.returncode == 0, done.stdout[-200:]


@needs("systemd-analyze")
def test_the_exposure_check_can_fail(subject: Path) -> None:
    lines = subject.read_text().splitlines()
    subject.write_text("\n".join(line for line in lines if not line.startswith(("Protect", "Private"))))
    done = run("systemd-analyze", "security", "--offline=true", "--threshold=20", "--no-pager", str(subject))
    assert done.returncode != 0


def test_the_unit_says_ready_by_itself_and_is_watched(subject: Path) -> None:
    text = subject.read_text()
    for line in ("Type=notify", "NotifyAccess=main", "WatchdogSec=5", "Restart=on-failure", "User=cellward"):
        assert line in text.splitlines()


@needs("systemd-sysusers")
@needs("systemd-tmpfiles")
def test_user_groups_and_folders_are_made_in_a_scratch_root(tmp_path: Path) -> None:
    (tmp_path / "etc").mkdir()
    done = run("systemd-sysusers", f"--root={tmp_path}", str(DEPLOY / "sysusers.conf"))
    assert done.returncode == 0, done.stderr
    user = next(line for line in (tmp_path / "etc/passwd").read_text().splitlines() if "cellward" in line)
    assert user.endswith(":/usr/sbin/nologin")
    groups = (tmp_path / "etc/group").read_text()
    assert re.search(r"^dialout:x:\d+:cellward$", groups, re.MULTILINE)
    assert re.search(r"^plugdev:x:\d+:cellward$", groups, re.MULTILINE)


@needs("systemd-tmpfiles")
def test_the_folders_have_the_modes_that_the_daemon_relies_on(tmp_path: Path) -> None:
    (tmp_path / "etc").mkdir()
    ids = "cellward:x:{0}:{0}::/:/bin/false\n".format
    uid = (tmp_path / "x").parent.stat().st_uid
    gid = (tmp_path / "x").parent.stat().st_gid
    (tmp_path / "etc/passwd").write_text("root:x:0:0::/:/bin/sh\n" + ids(uid))
    (tmp_path / "etc/group").write_text(f"root:x:0:\ncellward:x:{gid}:\n")
    done = run("systemd-tmpfiles", f"--root={tmp_path}", "--create", str(DEPLOY / "tmpfiles.conf"))
    assert done.returncode == 0, done.stderr
    modes = {p: (tmp_path / p).stat().st_mode & 0o777 for p in ("etc/cellward", "var/lib/cellward/runs")}
    assert modes == {"etc/cellward": 0o755, "var/lib/cellward/runs": 0o750}


def test_udev_rules_are_rows_of_comparisons_and_assignments() -> None:
    item = re.compile(r'[A-Z]+(\{\w+\})?(==|=|\+=)"[^"]*"')
    rules = [
        line
        for line in (DEPLOY / "70-cellward.rules").read_text().splitlines()
        if line and not line.startswith("#")
    ]
    assert rules
    for rule in rules:
        assert all(item.fullmatch(part.strip()) for part in rule.split(",")), rule
        assert "==" in rule, "a rule without a comparison holds for every device"
    oak = next(rule for rule in rules if "03e7" in rule)
    assert "idProduct" not in oak, "the camera boots with another product id"


@needs("systemd-analyze")
def test_the_exposure_is_reported_item_by_item_for_the_manual(subject: Path) -> None:
    done = run("systemd-analyze", "security", "--offline=true", "--json=short", "--no-pager", str(subject))
    exposed = {row["name"] for row in json.loads(done.stdout) if float(row["exposure"] or 0) >= 0.3}
    assert exposed <= {
        "PrivateNetwork=",
        "RestrictAddressFamilies=~AF_(INET|INET6)",
        "RestrictAddressFamilies=~…",
    }


def test_a_wrong_configuration_is_not_started_again_and_again(subject: Path) -> None:
    assert f"RestartPreventExitStatus={BAD_INPUT} {REFUSED}" in subject.read_text().splitlines()


def test_the_daemon_is_told_who_asks_at_its_socket(subject: Path) -> None:
    """In a user namespace of its own every other user is 65534, nobody."""
    assert not [line for line in subject.read_text().splitlines() if line.startswith("PrivateUsers=")]


def test_the_unit_permits_the_priorities_and_the_devices_that_the_daemon_asks_for(subject: Path) -> None:
    lines = subject.read_text().splitlines()
    (limit,) = (int(line.partition("=")[2]) for line in lines if line.startswith("LimitRTPRIO="))
    assert limit >= max(priority.LOOP, priority.SETPOINTS)
    assert "RestrictRealtime=yes" not in lines
    assert f"Nice={SERVICE_NICE}" in lines
    (weight,) = (int(line.partition("=")[2]) for line in lines if line.startswith("CPUWeight="))
    assert weight > 100, "nice values count within the unit only; 100 is everybody's weight"
    filters = [line for line in lines if line.startswith("SystemCallFilter=")]
    assert "sched_setscheduler" in filters[-1], "allowed again after ~@resources took it away"
    for device in ("usb_device", "ttyUSB", "ttyACM", "ttyS"):
        assert f"DeviceAllow=char-{device} rw" in lines


def test_the_unit_names_a_manual_that_is_installed() -> None:
    unit = (DEPLOY / "cellward.service").read_text("utf-8")
    (page,) = re.findall(r"(?m)^Documentation=.*file://(\S+)$", unit)
    assert page.startswith("/opt/cellward/current/share/doc/cellward/")
    assert (ROOT / "docs" / page.rpartition("/")[2]).is_file()
    data = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["setuptools"]["data-files"]
    assert "docs/*.md" in data["share/doc/cellward"]


def test_the_unit_reaches_nothing_but_this_computer_before_somebody_says_what() -> None:
    lines = (DEPLOY / "cellward.service").read_text("utf-8").splitlines()
    assert [line for line in lines if line.startswith("IPAddress")] == [
        "IPAddressDeny=any",
        "IPAddressAllow=localhost",
    ]


def test_the_extras_that_are_installed_are_in_the_wheelhouse_and_the_image() -> None:
    """All but the large one of decision 0050: on the PC of a cell nothing can be installed later."""
    asked = re.search(r"cellward\[([a-z,]+)\]==", (ROOT / "daemon/service/program.py").read_text("utf-8"))
    assert asked is not None
    assert set(asked[1].split(",")) == {"mqtt", "mcap"}
    for file in ("Makefile", "deploy/Containerfile"):
        assert f"'.[{asked[1]}]'" in (ROOT / file).read_text("utf-8"), file
