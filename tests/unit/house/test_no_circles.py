"""No circle of imports, in whichever part of a file an import stands."""

from graphlib import CycleError, TopologicalSorter

import grimp
import pytest

PACKAGES = ("cell", "calibration", "procedures", "drivers", "fakes", "daemon")


def test_no_file_imports_itself_by_way_of_others() -> None:
    graph = grimp.build_graph(*PACKAGES, cache_dir=None, exclude_type_checking_imports=False)
    subject = TopologicalSorter({m: graph.find_modules_directly_imported_by(m) for m in graph.modules})
    try:
        subject.prepare()
    except CycleError as found:
        pytest.fail(" -> ".join(found.args[1]))
