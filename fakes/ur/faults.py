"""What the controller's faults change in its streams and replies."""

from dataclasses import dataclass, field

from fakes.faults.vocabulary import LinkFaults


@dataclass
class StreamFaults:
    """Lasting disturbances of one controller; the servers look at these fields."""

    link: LinkFaults = field(default_factory=LinkFaults)
    silent: bool = False
    freeze: bool = False
    duplicate: bool = False
    drop_packages: int = 0
    handshake_message: str | None = None
    missing: frozenset[str] = frozenset()
    first_package_delay_s: float = 0.0
    dashboard_delay_s: float = 0.0
    _open_at: float = 0.0

    def note_start(self, t: float) -> None:
        """A client started its stream at ``t``; a late first package counts from here."""
        self._open_at = t + self.first_package_delay_s

    def stream_open(self, t: float) -> bool:
        """Whether a data package goes out at ``t``."""
        if self.silent or t < self._open_at:
            return False
        if self.drop_packages > 0:
            self.drop_packages -= 1
            return False
        return True

    def copies(self) -> int:
        """How often each data package is sent."""
        return 2 if self.duplicate else 1
