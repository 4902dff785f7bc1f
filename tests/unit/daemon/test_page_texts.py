"""The page's words: one catalogue, every text in every language, none missing and none left over."""

import json
import re

import pytest

from daemon.config.faces import Role
from daemon.web.page_files import page_files

FILES = page_files()
CATALOGUE = json.loads(FILES["texts.json"].content)
SCRIPTS = {
    name: file.content.decode()
    for name, file in FILES.items()
    if name.endswith(".js") and not name.startswith("vendor/")
}
LANGUAGES = re.findall(r"(\w\w): \"", re.findall(r"LANGUAGES = (\{.*?\})", SCRIPTS["texts.js"])[0])


def test_every_text_is_there_in_every_language_with_the_same_gaps_to_fill() -> None:
    assert LANGUAGES == ["en", "de"]
    for key, texts in CATALOGUE.items():
        assert list(texts) == LANGUAGES, key
        assert all(texts.values()), key
        gaps = {tuple(sorted(re.findall(r"\{(\w+)\}", text))) for text in texts.values()}
        assert len(gaps) == 1, key


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_every_text_that_a_script_asks_for_is_in_the_catalogue(name: str) -> None:
    script = SCRIPTS[name]
    asked = set(re.findall(r"\bt\(\s*\"([\w.]+)\"", script))
    asked |= {key for key in re.findall(r"\"([a-z]+\.[a-z_]+)\"", script) if key.split(".")[0] in PREFIXES}
    assert asked <= CATALOGUE.keys()
    families = set(re.findall(r"`([a-z]+)\.\$\{", script))
    assert families <= {key.split(".")[0] for key in CATALOGUE}


PREFIXES = {key.split(".")[0] for key in CATALOGUE}


def test_no_text_is_left_that_nobody_asks_for() -> None:
    everything = "\n".join(SCRIPTS.values())
    families = set(re.findall(r"`([a-z_]+)\.\$\{", everything))
    unused = [key for key in CATALOGUE if f'"{key}"' not in everything and key.split(".")[0] not in families]
    assert unused == []


def test_roles_states_and_verdicts_have_their_words() -> None:
    for role in Role.__args__:  # type: ignore[attr-defined]
        assert f"role.{role}" in CATALOGUE
    for verdict in ("pass", "warn", "fail"):
        assert f"verdict.{verdict}" in CATALOGUE
