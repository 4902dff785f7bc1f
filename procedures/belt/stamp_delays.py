"""What is known of how late the stamps of camera and encoder are, and what that leaves open of a contact.

What counts is a delay against the arm's own stamps (record 0062). With pictures stamped late by ``c``, counts
by ``e`` and the arm's states by ``a``, of a belt with speed ``v`` at the picture and ``w`` at the contact, an
item is ahead of where the tool meets it by

    c v + e (w - v) - a w

along the belt: at an even speed counts cost nothing, and a delay that all three have costs nothing at any.
A camera is measured against the arm, which is ``c - a``, and an encoder against the camera, ``e - c``. What
was not measured counts as such devices are late.

So the error of an encoder's delay has that of the camera in it. Where the camera's is still the same
measurement, with an error ``dc``, and the encoder's own is ``de``, pictures are late by ``dc`` and counts by
``dc + de``, and

    dc v + (dc + de) (w - v)  =  dc w + de (w - v)

is left. Where the camera was measured anew since, both errors are apart. It is assumed that a delay stays
what it was when it was measured, and that ``dc`` and ``de`` have nothing in common (they are of two runs).
Results of before the camera's version was kept in them do not say which of the two it is. The larger figure
counts then: that of errors together where the belt runs faster at the contact, and else that of errors apart.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import sqrt

import numpy as np

from cell.formats.result import Warning_
from cell.poses import Array
from cell.usual_delays import ARM, CAMERA, ENCODER, Usual
from procedures.report.numbers import K95
from procedures.words import mm, ms

CAMERA_ROLE, ENCODER_ROLE = "fixed_camera", "belt"
MEASURE = "`cellward start latency-calibration -p source={}`"
_NOTHING_M = 1e-5  # less than this of a contact is nothing to warn of
_NO_RUN_M_S = 0.1  # for words, where no contact tells a speed
Offsets = Mapping[str, Mapping[str, float]]
Term = tuple[Usual, float]


class StampDelays:
    """Of one run, whose contacts are told by ``met``.

    ``offsets`` are those in effect by role, with the ``sigma`` of one that was measured, and of the encoder
    the ``camera_sigma`` in it (0: of another measurement of the camera; absent: not known).
    """

    def __init__(self, offsets: Offsets) -> None:
        camera, encoder = (offsets.get(role, {}).get("sigma") for role in (CAMERA_ROLE, ENCODER_ROLE))
        self.camera_measured, self.encoder_measured = camera is not None, encoder is not None
        self._camera = CAMERA if camera is None else Usual(0.0, camera)
        self._encoder = ENCODER if encoder is None else Usual(0.0, encoder)
        self._camera_in_encoder = offsets.get(ENCODER_ROLE, {}).get("camera_sigma")
        self._speeds: list[tuple[float, float]] = []

    @property
    def camera_95_s(self) -> float | None:
        """Half of the 95 % interval of the camera's delay, s; None where it was not measured."""
        return K95 * self._camera.sigma_s if self.camera_measured else None

    def variance(self, seen_m_s: float, contact_m_s: float) -> float:
        """m^2 along the belt, of an item with these speeds of the belt at its pictures and at contact."""
        return _mean_square(self._terms(seen_m_s, contact_m_s))

    def met(self, seen_m_s: float, contact_m_s: float) -> None:
        """A contact was made, with these speeds of the belt as in ``variance``."""
        self._speeds.append((seen_m_s, contact_m_s))

    def assumed(self) -> list[str]:
        """In words, what counts without a measurement, and as how much."""
        out = []
        if not self.camera_measured:
            out.append(
                f"the delay of the camera's stamps as {ms(self._camera.rms_s)} and of the arm's as "
                f"{ms(ARM.rms_s)} (root mean square)"
            )
        if not self.encoder_measured:
            beside = f" and of the arm's as {ms(ARM.rms_s)}" if self.camera_measured else ""
            out.append(
                f"the delay of the encoder's stamps as {ms(self._encoder.rms_s)}{beside} (root mean square)"
            )
        return out

    def warnings(self) -> list[Warning_]:
        """One for each delay that was not measured: what it leaves open of the contacts, and what measures
        it."""
        return [Warning_(code="belt.delays", text=text) for text in self._costs()]

    def _costs(self) -> Iterator[str]:
        speeds = np.array(self._speeds or [(_NO_RUN_M_S, _NO_RUN_M_S)])
        of = "the run's " if self._speeds else ""
        terms = [self._terms(seen, contact) for seen, contact in speeds]
        if not self.camera_measured:
            yield (
                f"how late the stamps of the camera are against the arm's was not measured: as "
                f"{ms(self._camera.rms_s)} and {ms(ARM.rms_s)} (root mean square) it leaves every contact "
                f"open by {_mm95([(camera, arm) for camera, _, arm in terms])} (95 %) along the belt at "
                f"{of}{_rms(speeds[:, 0]):.2f} m/s; {MEASURE.format(CAMERA_ROLE)} measures it"
            )
        if not self.encoder_measured:
            # The arm's is in the warning of the camera, or else here.
            parts = [each[1:] if self.camera_measured else each[1:2] for each in terms]
            change = _rms(speeds[:, 1] - speeds[:, 0])
            if not self._speeds:  # at an even speed nothing, which would say nothing
                change, parts = _NO_RUN_M_S, [((self._encoder, _NO_RUN_M_S),)]
            if self._speeds and _mean95(parts) < _NOTHING_M:
                return
            yield (
                f"how late the stamps of the encoder are was not measured: as {ms(self._encoder.rms_s)} "
                f"(root mean square) it leaves contacts open by {_mm95(parts)} (95 %) along the belt where "
                f"the belt's speed changes by {of}{change:.3f} m/s between picture and contact; "
                f"{MEASURE.format(ENCODER_ROLE)} measures it, once the camera's is known"
            )

    def _terms(self, seen: float, contact: float) -> tuple[Term, Term, Term]:
        """Of camera, encoder and arm, each with the speed (m/s) that it counts by."""
        change = contact - seen
        # Counts that were measured against pictures are late with them.
        late_together = self.encoder_measured and not self.camera_measured
        arm = contact if not self.camera_measured else 0.0 if self.encoder_measured else change
        if self.camera_measured and self.encoder_measured and self._errors_together(seen * change > 0.0):
            own = Usual(0.0, sqrt(self._encoder.sigma_s**2 - self._camera.sigma_s**2))
            return (self._camera, contact), (own, change), (ARM, 0.0)
        return (self._camera, contact if late_together else seen), (self._encoder, change), (ARM, -arm)

    def _errors_together(self, faster: bool) -> bool:
        """Whether the encoder's error has the camera's in it; where nobody knows, what is the larger."""
        inside = self._camera_in_encoder
        if self._encoder.sigma_s < self._camera.sigma_s:
            return False  # the camera's was smaller then, so it was another measurement
        return faster if inside is None else inside > 0.0


def _mean_square(terms: Sequence[Term]) -> float:
    """m^2: what is late on average adds up with its sign, the rest by squares."""
    mean = sum(delay.mean_s * speed for delay, speed in terms)
    return mean**2 + sum((delay.sigma_s * speed) ** 2 for delay, speed in terms)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _mean95(contacts: Sequence[Sequence[Term]]) -> float:
    return K95 * float(np.sqrt(np.mean([_mean_square(terms) for terms in contacts])))


def _mm95(contacts: Sequence[Sequence[Term]]) -> str:
    return mm(_mean95(contacts))
