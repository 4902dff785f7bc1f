"""Stands in for ``cellward-twin``, of which the demo starts several: it imports nothing that takes time."""

import signal
import sys
from pathlib import Path


def twin(words: list[str]) -> None:
    folder = Path(words[words.index("--out") + 1])
    if words[0] == "truth":
        print((folder / "truth.json").read_text())
    elif words[0] == "operator":
        with (folder / "placed").open("a") as file:
            file.write(f"{words[2]}\n")
    else:
        (folder / "twin.sock").unlink(missing_ok=True)
        bind = f"127.0.0.11:{(folder / 'port').read_text()}"
        (folder / "cell.new").write_text(f'[cell]\nstate_dir = "{folder}/state"\n[modbus]\nbind = "{bind}"\n')
        (folder / "cell.new").rename(folder / "cell.toml")
        signal.pause()


if __name__ == "__main__":
    twin(sys.argv[1:])
