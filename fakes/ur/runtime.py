"""The program runner: at most one main program, advanced one step per control cycle."""

from collections.abc import Callable, Generator
from dataclasses import dataclass
from enum import IntEnum

LOAD_S = 0.01  # from the last byte of a program to its first step

Steps = Generator[None, None, None]


class RuntimeState(IntEnum):
    """RTDE ``runtime_state``."""

    STOPPING = 0
    STOPPED = 1
    PLAYING = 2
    PAUSING = 3
    PAUSED = 4
    RESUMING = 5


class ScriptError(Exception):
    """A program's error; it ends the program and is shown on the primary port.

    ``placed`` says that ``line`` is known, and not the one that every error begins with.
    """

    def __init__(self, text: str, line: int = 1, column: int = 0, placed: bool = False) -> None:
        super().__init__(text)
        self.text, self.line, self.column, self.placed = text, line, column, placed


@dataclass
class Program:
    """A program as the runner sees it: each ``next`` of ``steps`` is one control cycle."""

    name: str
    steps: Steps
    kind: str  # "control", "script" or "foreign"


class Runtime:
    """Runs programs, and says so: ``notify(event, program, error)`` on start, stop, pause and error."""

    def __init__(
        self,
        moving: Callable[[float], bool],
        halt: Callable[[float], None],
        notify: Callable[[str, str, ScriptError | None], None],
    ) -> None:
        self._moving, self._halt, self._notify = moving, halt, notify
        self.state = RuntimeState.STOPPED
        self.program: Program | None = None
        self._next: tuple[float, Program] | None = None

    @property
    def active(self) -> bool:
        """A program runs, is paused, or is about to run."""
        return self.program is not None or self._next is not None

    def start(self, program: Program, t: float) -> None:
        """Replace whatever runs by ``program``."""
        self.stop(t)
        self._next = (t + LOAD_S, program)

    def stop(self, t: float) -> None:
        """End the program; the arm decelerates."""
        self._next = None
        if self.program is not None:
            self._end(self.program, t)

    def pause(self, t: float) -> bool:
        """Hold the program and decelerate; False when nothing plays."""
        if self.program is None or self.state not in (RuntimeState.PLAYING, RuntimeState.RESUMING):
            return False
        self.state = RuntimeState.PAUSING
        self._halt(t)
        return True

    def resume(self, t: float) -> bool:
        """Go on after a pause; interrupted moves are continued to their targets."""
        if self.state not in (RuntimeState.PAUSED, RuntimeState.PAUSING):
            return False
        self.state = RuntimeState.RESUMING
        self._notify("RESUMED", self.program.name if self.program else "", None)
        return True

    def settle(self, t: float) -> None:
        """Finish stopping or pausing once the arm is at rest; runs in safety stops too."""
        if self.state == RuntimeState.STOPPING and not self._moving(t):
            self.state = RuntimeState.STOPPED
        if self.state == RuntimeState.PAUSING and not self._moving(t):
            self.state = RuntimeState.PAUSED
            self._notify("PAUSED", self.program.name if self.program else "", None)

    def step(self, t: float) -> None:
        """One control cycle."""
        self.settle(t)
        if self.state == RuntimeState.RESUMING:
            self.state = RuntimeState.PLAYING
        self._begin_next(t)
        if self.state == RuntimeState.PLAYING and self.program is not None:
            self._advance(self.program, t)

    def _begin_next(self, t: float) -> None:
        if self._next is None or t < self._next[0] or self.state != RuntimeState.STOPPED:
            return
        self.program, self._next = self._next[1], None
        self.state = RuntimeState.PLAYING
        self._notify("STARTED", self.program.name, None)

    def _advance(self, program: Program, t: float) -> None:
        try:
            next(program.steps)
        except StopIteration:
            self._end(program, t)
        except ScriptError as exc:
            self._end(program, t, exc)

    def _end(self, program: Program, t: float, failure: ScriptError | None = None) -> None:
        self.program = None
        program.steps.close()
        self._halt(t)
        self.state = RuntimeState.STOPPING if self._moving(t) else RuntimeState.STOPPED
        self._notify("STOPPED", program.name, failure)
