"""The input module as a thing: what its terminals see and what its counters show, whatever the wire is.

Every face shares it, so its faults (stuck and bouncing inputs, counters near their wrap or back at zero, an
image that stands still) live here; what can go wrong on a link lives in the face.
"""

from bisect import bisect_right
from math import inf

from fakes.world.beams.beams import Beams
from fakes.world.beams.input_channel import InputChannel
from fakes.world.beams.truth import CHANNELS, IoTruth

Image = tuple[tuple[bool, ...], tuple[int, ...]]


class InputModule:
    """Levels and counters of the wired channels as functions of time (s on the twin's clock).

    Faults begin at a time that is not before any that was asked for.
    """

    MODULUS = 1 << 32

    def __init__(self, truth: IoTruth, beams: Beams, t0: float) -> None:
        self.truth = truth
        self.channels = CHANNELS[truth.module]
        self._beams = beams
        self._kept: tuple[float, float, int, Image] | None = None  # an image, from when to when, foreseen
        by_channel = {channel: name for name, channel in truth.inputs.items()}
        self._inputs = [
            InputChannel(beams, name, name in truth.inverted, truth.filter_s, truth.scan_s, t0)
            for name in map(by_channel.get, range(max(by_channel, default=-1) + 1))
        ]
        self._frozen: list[tuple[float, bool]] = [(-inf, False)]
        self._presets: list[tuple[float, tuple[int, ...]]] = [(-inf, (0,) * len(self._inputs))]
        if truth.bounce_s:
            self.bounce(t0, truth.bounce_s)

    def levels(self, t: float) -> tuple[bool, ...]:
        """The electrical level of channels ``0 .. n-1`` at ``t``, up to the last one that is wired."""
        t = self._shown(t)
        return tuple([channel.level(t) for channel in self._inputs])

    def counts(self, t: float) -> tuple[int, ...]:
        """Rising edges that the module has counted per channel by ``t``, modulo :attr:`MODULUS`.

        As many as :meth:`levels` has; none at all when the module has no counters.
        """
        return self.image(t)[1]

    def image(self, t: float) -> Image:
        """What :meth:`levels` and :meth:`counts` say at ``t``."""
        kept = self._kept
        if kept is not None and kept[0] <= t < kept[1] and kept[2] == self._beams.foreseen:
            return kept[3]
        found = self._image(self._shown(t))
        # Polls come by the hundred between two edges.
        if len(self._frozen) == 1:
            later = (since for since, _ in self._presets if since > t)  # a poll of before may be asked late
            until = min([*later, *(channel.quiet_until(t) for channel in self._inputs)], default=inf)
            self._kept = t, until, self._beams.foreseen, found
        return found

    def _image(self, t: float) -> Image:
        both = [channel.image(t) for channel in self._inputs]
        levels = tuple([level for level, _ in both])
        if not self.truth.counters:
            return levels, ()
        preset = self._presets[0][1]
        if len(self._presets) > 1:
            preset = self._presets[bisect_right(self._presets, t, key=_when) - 1][1]
        counts = tuple([(count + more) % self.MODULUS for (_, count), more in zip(both, preset, strict=True)])
        return levels, counts

    # -- faults

    def stick(self, t: float, level: bool | None, beam: str | None = None) -> None:
        """From ``t`` on the input of ``beam``, or every one, is on or off whatever happens; None frees it."""
        self._kept = None
        for channel in self._chosen(beam):
            channel.stick(t, level)

    def bounce(self, t: float, duration_s: float) -> None:
        """From ``t`` on every contact bounces for so long at every edge."""
        self._kept = None
        for channel in self._inputs:
            channel.bounce(t, duration_s)

    def preset(self, t: float, value: int) -> None:
        """From ``t`` on all counters go on from ``value``."""
        self._kept = None
        now = self._shown(t)
        self._presets.append((now, tuple(value - channel.count(now) for channel in self._inputs)))

    def reboot(self, t: float) -> None:
        """The module starts at ``t``: counters are zero, and it looks again."""
        self.freeze(t, False)
        self.preset(t, 0)

    def freeze(self, t: float, frozen: bool) -> None:
        """From ``t`` on the module shows what it has, or lives again."""
        self._kept = None
        if frozen != self._frozen[-1][1]:
            self._frozen.append((t, frozen))

    def clear(self, t: float) -> None:
        """End every fault that lasts; what the scenario says stays."""
        self.stick(t, None)
        self.bounce(t, self.truth.bounce_s)
        self.freeze(t, False)

    def _chosen(self, beam: str | None) -> list[InputChannel]:
        return self._inputs if beam is None else [self._inputs[self.truth.inputs[beam]]]

    def _shown(self, t: float) -> float:
        """The time whose image the module shows at ``t``."""
        if len(self._frozen) == 1:
            return t
        since, frozen = self._frozen[bisect_right(self._frozen, t, key=_when) - 1]
        return since if frozen else t


def _when(event: tuple[float, object]) -> float:
    return event[0]
