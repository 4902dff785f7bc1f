"""Whose end of our script was it: our own watchdog's, so that it may be opened again, or somebody else's?"""

import pytest

from drivers.ur.feed import PLAYING, STOPPED
from drivers.ur.script_end import Kicks, ScriptEnd, ScriptRecord

PATIENCE_S, PERIOD_S, PACKAGE_S = 0.1, 0.02, 0.002
STOPPING, PAUSING, PAUSED = 0, 3, 4


class Script:
    """A record in which our script plays from 0 s on, and what the child tells."""

    def __init__(self) -> None:
        self.kicks = Kicks()
        self.record = ScriptRecord(self.kicks, PATIENCE_S)
        self.record.expect()
        self._t = 0.0
        self.play(0.0)

    def kick(self, since: float, until: float) -> None:
        count = round((until - since) / PERIOD_S)
        for k in range(count + 1):
            self.kicks.note(since + k * PERIOD_S)

    def play(self, until: float) -> None:
        while self._t <= until:
            self.record.note(PLAYING, self._t)
            self._t += PACKAGE_S

    def stop(self, at: float) -> ScriptEnd:
        self.record.note(STOPPED, at)
        return self.record.end


@pytest.fixture
def subject() -> Script:
    return Script()


def test_a_script_that_plays_has_no_end(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.0)
    assert subject.record.runs
    assert subject.record.end is ScriptEnd.NONE


@pytest.mark.parametrize("ended", [1.001, 1.01, 1.03, 1.06])
def test_a_script_that_ends_while_it_is_kicked_was_ended_by_others(ended: float, subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(ended)
    assert subject.stop(ended + PACKAGE_S) is ScriptEnd.OTHERS


@pytest.mark.parametrize("late", [0.15, 0.5, 5.0], ids=lambda s: f"{s:g} s")
def test_a_native_call_that_waits_because_the_script_is_gone_makes_the_end_not_ours(
    late: float, subject: Script
) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.01)
    assert subject.stop(1.012) is ScriptEnd.OTHERS
    subject.kicks.note(1.0 + late)
    assert subject.record.end is ScriptEnd.OTHERS, "a lapse that came after the end explains nothing"


def test_a_script_that_ends_after_the_watchdog_s_patience_was_ended_by_it(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.1)
    assert subject.stop(1.104) is ScriptEnd.OURS
    subject.kick(1.5, 2.0)
    assert subject.record.end is ScriptEnd.OURS, "also when kicks come again"


def test_a_kick_that_was_told_but_never_left_may_have_been_the_one_before(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.08)
    assert subject.stop(1.082) is ScriptEnd.OURS


def test_a_lapse_before_the_end_is_not_its_cause(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.kick(1.3, 2.0)  # the watchdog bore it, and the script went on
    subject.play(2.01)
    assert subject.stop(2.012) is ScriptEnd.OTHERS


def test_an_end_within_a_gap_of_the_arm_s_states_is_unseen_whatever_the_kicks_say(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.02)
    assert subject.stop(1.3) is ScriptEnd.UNSEEN


def test_a_script_that_plays_on_after_a_gap_and_ends_later_is_judged_by_the_kicks(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.02)
    subject.record.note(PLAYING, 1.5)
    assert subject.stop(1.55) is ScriptEnd.OURS


def test_a_script_whose_end_nobody_saw_because_the_link_was_lost_is_unseen(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.0)
    subject.record.lost = True
    assert subject.record.end is ScriptEnd.UNSEEN


def test_a_stop_at_the_pendant_just_before_the_link_was_lost_is_remembered(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.0)
    subject.stop(1.002)
    subject.record.lost = True
    assert subject.record.end is ScriptEnd.OTHERS


def test_what_we_ended_by_a_command_is_ours(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.0)
    subject.record.ask_end()
    assert subject.stop(1.002) is ScriptEnd.OURS


def test_a_command_of_ours_after_the_end_does_not_make_it_ours(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.0)
    subject.stop(1.002)
    subject.record.ask_end()
    assert subject.record.end is ScriptEnd.OTHERS


def test_the_end_is_where_the_script_ceased_to_play_not_where_the_arm_stood(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.0)
    subject.record.note(PAUSING, 1.01)
    assert subject.stop(1.15) is ScriptEnd.OTHERS


@pytest.mark.parametrize("paused", [0.12, 0.15, 0.5], ids=lambda s: f"{s:g} s")
def test_a_short_pause_of_the_client_counts_as_ours_however_long_the_arm_decelerates(
    paused: float, subject: Script
) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.1)
    subject.record.note(STOPPING, 1.104)
    subject.kicks.note(1.0 + paused)  # the last one: the script does not take it
    for k in range(200):
        subject.record.note(STOPPING, 1.106 + k * PACKAGE_S)
    assert subject.stop(1.6) is ScriptEnd.OURS


def test_a_script_that_was_paused_and_played_on_did_not_end_there(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.0)
    subject.record.note(PAUSED, 1.002)
    subject.kick(1.02, 3.0)
    subject.record.note(PLAYING, 1.05)
    assert subject.record.runs
    subject.record.note(PLAYING, 3.1)
    assert subject.record.end is ScriptEnd.NONE
    assert subject.stop(3.104) is ScriptEnd.OURS


def test_a_later_program_is_not_ours(subject: Script) -> None:
    subject.kick(0.0, 1.0)
    subject.play(1.0)
    subject.stop(1.002)
    subject.record.note(PLAYING, 1.2)
    assert not subject.record.runs


@pytest.mark.parametrize(("last_kick", "end"), [(1.0, ScriptEnd.OURS), (1.09, ScriptEnd.OTHERS)])
def test_whose_end_it_was_is_known_while_the_arm_still_decelerates(
    last_kick: float, end: ScriptEnd, subject: Script
) -> None:
    subject.kick(0.0, last_kick)
    subject.play(1.1)
    subject.record.note(STOPPING, 1.104)
    assert subject.record.runs
    subject.record.ask_end()  # closing the port meanwhile changes nothing
    assert subject.record.end is end
