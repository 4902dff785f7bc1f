"""One daemon with a page for all tests of this folder."""

from collections.abc import Iterator

import pytest

from tests.kit.page_cell import PageCell, page_cell


@pytest.fixture(scope="session")
def subject(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PageCell]:
    with page_cell(tmp_path_factory.mktemp("page")) as cell:
        yield cell
