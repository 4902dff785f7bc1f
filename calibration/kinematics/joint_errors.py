"""How far joints turn beyond what they read: errors of their gears, and giving way under the arm's weight.

An error is a wave over the joint angles. A gear has one once and twice a turn of its joint; what carries the
arm gives way with the cosine of the loaded links' angles to the horizontal, whatever their offsets.
Source: Whitney, Lozinski and Rourke, Industrial Robot Forward Calibration Method and Results, ASME J. Dyn.
Syst. 1986 (gears and compliance beside the geometry).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cell.poses import Array

_PARALLEL = 0.0175  # rad
_PITCHES = 2  # upper and fore arm; what follows is light and short


@dataclass(frozen=True, eq=False)
class JointErrors:
    """t errors: ``joint`` (t,), from 0, turns ``sin`` times the sine and ``cos`` times the cosine of
    ``of @ q`` further than it reads; ``of`` (t, j), amplitudes (t,) in rad. ``names`` (t,)."""

    names: tuple[str, ...]
    joint: NDArray[np.int64]
    of: Array
    sin: Array
    cos: Array

    def waves(self, Q: Array) -> tuple[Array, Array]:
        """Sines and cosines (t, n) at ``Q`` (n, j)."""
        angle = self.of @ Q.T
        return np.sin(angle), np.cos(angle)

    def actual(self, Q: Array) -> Array:
        """(n, j): where the joints are that read ``Q`` (n, j)."""
        sines, cosines = self.waves(Q)
        added = self.sin[:, None] * sines + self.cos[:, None] * cosines
        out = np.array(Q, dtype=float)
        np.add.at(out.T, self.joint, added)
        return out

    def moved(self, amplitudes: Array) -> "JointErrors":
        """With ``amplitudes`` (2 t,) added: the sines', then the cosines'."""
        sine, cosine = amplitudes[: len(self.names)], amplitudes[len(self.names) :]
        return replace(self, sin=self.sin + sine, cos=self.cos + cosine)

    @property
    def amplitudes(self) -> tuple[str, ...]:
        """Names (2 t,) of the amplitudes, as :meth:`moved` takes them."""
        return tuple(f"{name}.{wave}" for wave in ("sin", "cos") for name in self.names)

    def beside(self, others: "JointErrors | None") -> "JointErrors":
        """These and ``others``."""
        if others is None:
            return self
        return JointErrors(
            (*others.names, *self.names),
            *(
                np.concatenate([getattr(others, key), getattr(self, key)])
                for key in ("joint", "of", "sin", "cos")
            ),
        )


def of_gears(coupling: Array, sliding: NDArray[np.bool_]) -> JointErrors:
    """Once and twice a turn of the link that a joint drives; zero so far. A sliding joint has none.

    ``coupling`` (m, j) and ``sliding`` (m,) are those of a chain.
    """
    names, rows = [], []
    for j in range(coupling.shape[1]):
        link = int(np.argmax(np.abs(coupling[:, j]) * ~sliding))
        turns = abs(coupling[link, j])
        if sliding[link] or turns == 0.0:
            continue
        for times in (1, 2):
            names.append((f"gear{j + 1}.{times}", j))
            rows.append(times * turns * np.eye(coupling.shape[1])[j])
    return none_yet(names, rows, coupling.shape[1])


def of_sag(coupling: Array, alpha: Array, sliding: NDArray[np.bool_]) -> JointErrors:
    """Upper and fore arm loading the joints that carry them; zero so far. The second axis must be level.

    ``alpha`` (m,) turns from one axis to the next; axes that stay parallel to the second one carry.
    """
    names, rows = [], []
    pitch, sense, carriers = np.zeros(coupling.shape[1]), 1.0, list[int]()
    if abs(np.cos(alpha[0])) < _PARALLEL:
        for link in range(1, len(alpha)):
            if len(carriers) == _PITCHES or sliding[link] or not np.any(coupling[link]):
                break
            pitch = pitch + sense * coupling[link]
            carriers.append(int(np.argmax(np.abs(coupling[link]))))
            for joint in carriers:
                part = ("upper", "fore")[len(carriers) - 1]
                names.append((f"sag{joint + 1}.{part}", joint))
                rows.append(pitch)
            if abs(np.sin(alpha[link])) > _PARALLEL:
                break
            sense *= float(np.sign(np.cos(alpha[link])))
    return none_yet(names, rows, coupling.shape[1])


def none_yet(names: list[tuple[str, int]], rows: list[Array], joints: int) -> JointErrors:
    """``names`` with the joint that turns, and the ``rows`` of ``of``; amplitudes of zero."""
    t = len(names)
    return JointErrors(
        tuple(name for name, _ in names),
        np.array([joint for _, joint in names], dtype=np.int64),
        np.array(rows).reshape(t, joints),
        np.zeros(t),
        np.zeros(t),
    )
