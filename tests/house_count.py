"""In how many folders a family of jobs lives, at any commit: ``python tests/house_count.py [REVISION]...``.

A file belongs to a family when its path says so. Drivers and the twin are left out: they are of devices.
``shared`` are files of ``procedures/`` and ``daemon/`` that belong to no family and name a job, a kind or a
module of it.
"""

import re
import subprocess
import sys

PACKAGES = ("cell", "calibration", "procedures", "daemon")
FAMILIES = {  # what the path of a family's file says, and what in another file names it
    "hand_eye": (
        r"hand_eye|cone_capture|(formats|solve)/capture|solve/(camera|images|other_orders)|verdict\.py$",
        r"cone-capture|\bhand-eye\"|procedures\.(hand_eye|cone_capture)",
    ),
    "laser": (r"laser(?!_tracker)|tool_frame", r"laser-(reference|check|update)|procedures\.laser\b"),
    "tracker": (
        r"kincal|identification|procedures/tracker/|(predict|plan)_tracker|compare_arms|verdict_arm",
        r"tracker-sampling|\bkincal\"|procedures\.tracker\b",
    ),
    "iso9283": (r"iso9283", r"iso9283"),
    "belt": (r"belt|intercept|live_text|verdict_picks", r"belt-(tracking|calibration)|procedures\.belt\b"),
    "latency": (r"latency", r"latency-calibration|procedures\.latency\b"),
    "eye_to_hand": (r"eye_to_hand|axbc", r"eye-to-hand-check|\baxbc\"|procedures\.eye_to_hand\b"),
    "slot": (r"(procedures|calibration)/slot/|slot\.py$", r"slot-insertion|procedures\.slot\b"),
    "corrected_targets": (r"corrected_targets", r"corrected-targets|procedures\.corrected_targets\b"),
    "touch_test": (r"touch(_test)?[/.]", r"touch-test|procedures\.touch_test\b"),
    "cross_check": (r"cross_check", r"cross-check|procedures\.cross_check\b"),
}
_REPORT_VERDICT = "report/verdict.py"


def git(*words: str) -> str:
    return subprocess.run(["git", *words], capture_output=True, text=True, check=False).stdout


def main(revisions: list[str]) -> None:
    for revision in revisions or ["HEAD"]:
        if not git("rev-parse", "--verify", "--quiet", f"{revision}^{{commit}}"):
            sys.exit(f"'{revision}' is no commit of this repository; a shallow clone lacks the older ones")
        listed = git("ls-tree", "-r", "--name-only", revision, *PACKAGES).split()
        files = [f for f in listed if f.endswith(".py") and not f.endswith(_REPORT_VERDICT)]
        print(f"\n{git('log', '-1', '--format=%h %s', revision).strip()}")
        print(f"{'family':18}{'files':>7}{'folders':>9}{'shared':>8}")
        of = {name: {f for f in files if re.search(path, f)} for name, (path, _) in FAMILIES.items()}
        owned = set().union(*of.values())
        for name, (_, words) in FAMILIES.items():
            own = of[name]
            folders = {_family_folder(f) for f in own}
            naming = {
                line.partition(":")[2]
                for line in git("grep", "-lP", words, revision, "--", "procedures", "daemon").splitlines()
            }
            shared = {f for f in naming if f not in owned and f.endswith((".py", ".toml"))}
            print(f"{name:18}{len(own):7}{len(folders):9}{len(shared):8}")


def _family_folder(path: str) -> str:
    """Two levels are a room: what stands below ``procedures/laser`` is one folder."""
    return "/".join(path.split("/")[:2]) if path.count("/") > 1 else path.split("/")[0]


if __name__ == "__main__":
    main(sys.argv[1:])
