"""How far a scan is: ways there and back that are done, of the most that its plan has."""

from math import floor

from cell.procedure import Run
from procedures.laser.config import Search
from procedures.laser.path import BeamStation, Course, deepest, heights_at


def most_pairs(search: Search, course: Course, station: BeamStation) -> tuple[int, int]:
    """How many ways there and back finding the beam at ``station`` takes at most, and measuring it then."""
    looks = 1 + floor(max(deepest(search, course, station), 0.0) / search.descend_step_m + 1e-9)
    heights = len(heights_at(search, station))
    return looks + 1 + search.most_height_pairs, heights * search.passes + heights - 1


class ScanProgress:
    """Publishes the steps of a run that makes ``scans`` of this course from now on.

    A scan takes fewer ways than it might: those that turn out not to be needed count as done once the part
    that they belong to has ended. So the number of steps stays, and the parts keep their shares of it.
    """

    def __init__(self, run: Run, search: Search, course: Course, scans: int) -> None:
        self._run, self._search, self._course = run, search, course
        self._done = self._part_end = run.step
        scan = sum(sum(most_pairs(search, course, station)) for station in course.stations)
        self._scan_end, self._steps = run.step + scan, run.step + scans * scan
        self._publish()

    def find(self, station: BeamStation) -> None:
        """The beam is looked for from now on."""
        self._begin_part(most_pairs(self._search, self._course, station)[0])

    def measure(self, station: BeamStation) -> None:
        """The beam was found and is measured from now on."""
        self._begin_part(most_pairs(self._search, self._course, station)[1])

    def count(self) -> None:
        """A way there and back is done."""
        self._done = min(self._done + 1, self._part_end)
        self._publish()

    def end(self) -> None:
        """Every station is done; the parts that a beam which was not found made needless are, too."""
        self._done = self._part_end = self._scan_end
        self._publish()

    def _begin_part(self, pairs: int) -> None:
        self._done, self._part_end = self._part_end, self._part_end + pairs
        self._publish()

    def _publish(self) -> None:
        self._run.progress(self._done, self._steps)
