"""How often this machine paused while a test waited for other processes: each pause may explain one step."""

import threading
import time

LOOK_S = 0.005
LONG_S = 0.03  # a process that is late by this stands for others that may have been later


class Pauses:
    """A thread that is woken every ``LOOK_S`` and counts how often it was late by more than ``LONG_S``."""

    def __init__(self) -> None:
        self.count, self.longest_s = 0, 0.0
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._look, name="pauses", daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        """End the thread; may be called without a start."""
        self._end.set()
        if self._thread.is_alive():
            self._thread.join(5.0)

    def forget(self) -> None:
        """Count from here on."""
        self.count, self.longest_s = 0, 0.0

    def woken(self, late_s: float) -> None:
        if late_s > LONG_S:
            self.count += 1
            self.longest_s = max(self.longest_s, late_s)

    def require_explained(self, taken_again: int) -> None:
        """Each step that was taken again needs a pause: without one, nothing was silent."""
        assert taken_again <= self.count, (
            f"{taken_again} steps were taken again, but this machine paused {self.count} times "
            f"for more than {LONG_S} s, {self.longest_s:.3f} s at most"
        )

    def _look(self) -> None:
        due = time.monotonic() + LOOK_S
        while not self._end.wait(max(0.0, due - time.monotonic())):
            self.woken(time.monotonic() - due)
            due = time.monotonic() + LOOK_S
