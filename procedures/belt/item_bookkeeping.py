"""The bookkeeping of items in a run of picking: each is watched, ends once, and is written down."""

import asyncio
from collections.abc import Coroutine
from typing import Any

import numpy as np

from cell.errors import CellError
from cell.packml import PackML
from cell.procedure import Run
from procedures.belt.item_tracking import BeltWatch
from procedures.belt.items import Item, Outcome, life

LOOK_S = 0.05  # between looks while no stream runs
PUBLISH_S = 0.2


class ItemBookkeeping:
    """Looks at the belt beside the job, and by the stream itself while :attr:`streaming`: it knows when it
    has the time, and which item is in hand. ``picks``: how many are wanted, 0 for no end. ``carried`` is what
    the gripper had when the stream ended: picked once it is put down, else ``if_empty`` became of it."""

    def __init__(self, run: Run, watch: BeltWatch, picks: int, failed_grips: int) -> None:
        self._run, self._watch, self._picks = run, watch, picks
        self._failed_grips = failed_grips
        self.failed_in_a_row = 0
        self._writing: list[asyncio.Task[None]] = []
        self._published = -np.inf
        self.streaming = False
        self.carried: Item | None = None
        self.if_empty = Outcome.LOST  # of what is carried, where the gripper is seen to hold nothing

    async def beside(self, work: Coroutine[Any, Any, None]) -> None:
        """Do ``work`` and look meanwhile; what fails first ends both."""
        try:
            async with asyncio.TaskGroup() as group:
                looking = group.create_task(self._look_on(), name="item bookkeeping")
                await work
                looking.cancel()
        except BaseExceptionGroup as failed:
            raise failed.exceptions[-1] from None  # of both, the end of the work itself: it may lock motion

    def look(self, in_hand: Item | None = None) -> None:
        """Learn, end the items but ``in_hand`` that are lost or have left the zone, and tell.

        Raises what kept an earlier item from the ledger, and ``BELT_ASTRAY``.
        """
        while self._writing and self._writing[0].done():
            self._writing.pop(0).result()
        self._watch.learn()
        now = self._run.clock.now()
        self._end_missed(now, in_hand)
        if now - self._published >= PUBLISH_S:
            self._published = now
            forecast = self._watch.forecast
            position = 0.0 if forecast is None else forecast.travel(forecast.now)
            self._run.publish(
                belt_speed_m_s=self._watch.speed(),
                belt_position_m=position,
                **self._watch.queue.live(),
            )

    def end(self, item: Item, outcome: Outcome) -> None:
        """This became of ``item``, unless it has ended."""
        if item.outcome is None:
            self._watch.queue.end(item, outcome, self._run.clock.now())
            if outcome is Outcome.GRIP_FAILED:
                self.failed_in_a_row += 1
            elif outcome is Outcome.PICKED:
                self.failed_in_a_row = 0
            self._ended(item, outcome)

    @property
    def grips_fail(self) -> bool:
        """Whether so many grips in a row took nothing that it is an alarm."""
        return 0 < self._failed_grips <= self.failed_in_a_row

    def carry(self, item: Item, if_empty: Outcome) -> None:
        """The arm stopped with ``item``; ``if_empty`` became of it if the gripper holds nothing then."""
        self.carried, self.if_empty = item, if_empty

    @property
    def was_let_go(self) -> bool:
        """Whether the arm stopped with an item in its place that the gripper was told to let go of."""
        return self.carried is not None and self.if_empty is Outcome.PICKED

    def take_up(self) -> Item | None:
        """What the gripper has, for whoever goes on with it; None: nothing."""
        item, self.carried = self.carried, None
        return item

    def end_carried(self, outcome: Outcome) -> None:
        """This became of what was carried, if anything was."""
        if (item := self.take_up()) is not None:
            self.end(item, outcome)

    def _ended(self, item: Item, outcome: Outcome) -> None:
        """Keep what became of ``item`` in journal and ledger."""
        run, detail = self._run, life(item)
        if self._watch.record is not None:
            self._watch.record.ended(item)
        run.note("decision", event="item", item=item.number, outcome=outcome.value, **detail)
        before = self._writing[-1] if self._writing else None
        written = self._write(before, item.number, run.clock.now(), outcome, detail)
        self._writing.append(asyncio.create_task(written, name="item"))  # the disk must not hold the stream
        run.progress(self._watch.queue.counts[Outcome.PICKED], self._picks)

    async def _write(
        self,
        before: "asyncio.Task[None] | None",
        number: int,
        t: float,
        outcome: Outcome,
        detail: dict[str, Any],
    ) -> None:
        """After the one before: however long the disk takes, one thread waits for it."""
        if before is not None:
            await asyncio.wait([before])
        await self._run.cell.add_item(self._run, number, t, outcome.value, detail)

    async def close(self) -> None:
        """The last count, however the job ended; returns when the ledger has every item that ended."""
        self.end_carried(Outcome.LOST)  # nobody looked whether the gripper holds it
        self._end_missed(self._run.clock.now(), None)
        queue = self._watch.queue
        self._run.note("decision", event="counted", seen=queue.seen, waiting=queue.length)
        self._run.publish(**queue.live())
        await asyncio.gather(*self._writing)

    def _end_missed(self, now: float, in_hand: Item | None) -> None:
        for item, outcome in self._watch.missed(now, in_hand):
            self._ended(item, outcome)

    async def _look_on(self) -> None:
        while True:
            if not self.streaming:
                try:
                    self.look(self.carried)
                except CellError as exc:
                    # In a pause a person may be at the belt; it ends the job if it is still so afterwards.
                    if exc.name != "BELT_ASTRAY" or self._run.packml is not PackML.HELD:
                        raise
            await self._run.clock.sleep(LOOK_S)
