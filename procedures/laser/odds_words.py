"""The odds of the crossed beams' tests in words: how often a good tool fails one, and what each one finds."""

from procedures.laser.result import MovedTest, SecondScan
from procedures.words import mm


def odds(chance: float) -> str:
    """A chance as people say it: ``1 of 300``."""
    return f"1 of {1.0 / chance:.0f}"


def check_odds(false_alarm: float, size_m: float) -> str:
    """Of a laser-check that finds a shift of ``size_m`` (m) with 99 %."""
    return (
        f"a tool that has not moved is called moved in {odds(false_alarm)} checks at most, one that moved by "
        f"{mm(size_m)} in 99 of 100 at least"
    )


def second_odds(false_alarm: float, size_m: float) -> str:
    """Of the second scan of a laser-update that finds an error of ``size_m`` (m) with 99 %."""
    return (
        f"a right frame is turned down in {odds(false_alarm)} updates at most, one that is wrong by "
        f"{mm(size_m)} in 99 of 100 at least"
    )


def odds_of(test: MovedTest | SecondScan | None) -> str:
    """Of a test that was made; empty where its result has no odds, as those of earlier versions."""
    if test is None or test.false_alarm is None or test.detectable_m is None:
        return ""
    told = check_odds if isinstance(test, MovedTest) else second_odds
    return told(test.false_alarm, test.detectable_m)
