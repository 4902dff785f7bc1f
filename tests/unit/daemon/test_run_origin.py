"""A run says which software made it, on which configuration, and who wanted it."""

import hashlib
import platform
from importlib.metadata import version
from pathlib import Path

from daemon.config import load_config
from fakes.object import run_virtual
from tests.kit.object_cell import WHO, open_cell, write_config


def test_a_run_records_versions_configuration_and_who_started_it(tmp_path: Path) -> None:
    async def scenario() -> None:
        config = write_config(tmp_path)
        async with open_cell(config) as cell:
            info = cell.folder((await cell.dry_run())["run_id"]).info
        assert info["versions"]["cellward"] == version("cellward")
        assert info["versions"]["python"] == platform.python_version()
        assert info["started_by"] == {"who": WHO, "channel": "test"}
        assert info["config_digest"] == config.digest
        assert len(bytes.fromhex(info["config_digest"])) == hashlib.sha256().digest_size

    run_virtual(scenario())


def test_the_digest_follows_the_values_and_not_the_text(tmp_path: Path) -> None:
    subject = write_config(tmp_path)
    path = tmp_path / "cell.toml"
    text = path.read_text()
    path.write_text(f"# another comment\n{text}")
    assert load_config(path).digest == subject.digest
    path.write_text(text.replace("[device.camera]", "[device.camera]\ncalibrated = 2026-05-31"))
    dated = load_config(path)
    assert dated.digest != subject.digest
    assert dated.model_dump(mode="json")["device"]["camera"]["calibrated"] == "2026-05-31"
