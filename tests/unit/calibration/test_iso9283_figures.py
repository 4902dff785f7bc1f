"""AP and RP as the standard has them, held against sums done by hand and against chance."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from calibration.iso9283 import PLANES, drift, figures, five_places, other_corners, repeatability
from cell.errors import CellError
from cell.poses import Array, to_pose6
from tests.kit.solved import solve_iso9283

NO_LIMITS: dict[str, float | None] = {}


def test_figures_are_those_of_a_sum_done_by_hand() -> None:
    # Barycentre (0.001, 0, 0); distances 1, 1, 2 and 2 mm: mean 1.5 mm, S = sqrt(4 * 0.25 / 3) mm.
    points = np.array([[0.002, 0, 0], [0.0, 0, 0], [0.001, 0.002, 0], [0.001, -0.002, 0]])
    found = figures(points, np.array([0.001, 0.0, 0.0005]), 1e-6)
    assert found.barycentre == pytest.approx([0.001, 0.0, 0.0])
    assert found.deviation == pytest.approx([0.0, 0.0, -0.0005])
    assert pytest.approx(0.0005) == found.AP
    assert found.mean_distance == pytest.approx(0.0015)
    assert found.std_distance == pytest.approx(1e-3 * np.sqrt(1.0 / 3.0))
    assert pytest.approx(0.0015 + 3e-3 * np.sqrt(1.0 / 3.0)) == found.RP


def test_the_trackers_own_figures_are_what_a_perfect_arm_reads() -> None:
    rng, sigma = np.random.default_rng(1), 3e-5
    found = figures(rng.normal(size=(30, 3)), np.zeros(3), sigma)
    tests = sigma * rng.normal(size=(4000, 200, 3))
    assert np.mean([repeatability(t) for t in tests[:500]]) == pytest.approx(found.tracker_RP, rel=0.01)
    once = np.linalg.norm(tests[:, 0], axis=1)
    assert np.mean(once < found.tracker_AP) == pytest.approx(0.95, abs=0.012)


def test_the_stated_interval_of_RP_covers_the_true_one() -> None:
    rng = np.random.default_rng(2)
    true = np.sqrt(8 / np.pi) + 3 * np.sqrt(3 - 8 / np.pi)
    runs = [figures(rng.normal(size=(30, 3)), np.zeros(3), 1e-9) for _ in range(1000)]
    inside = [r.RP_95 is not None and r.RP_95[0] < true < r.RP_95[1] for r in runs]
    assert 0.945 < np.mean(inside) < 0.98


def test_too_few_arrivals_state_no_interval_of_RP() -> None:
    places = np.random.default_rng(3).normal(size=(5, 3))
    assert figures(places[:4], np.zeros(3), 1e-9).RP_95 is None
    assert figures(places, np.zeros(3), 1e-9).RP_95 is not None


@pytest.mark.parametrize("plane", sorted(PLANES))
def test_five_poses_lie_on_a_diagonal_plane_a_tenth_of_the_diagonal_from_its_ends(plane: str) -> None:
    centre, edge = np.array([0.5, 0.1, 0.6]), 0.4
    P = five_places(centre, edge, plane)
    np.testing.assert_allclose(P[0], centre)
    normal = np.linalg.svd(P - centre)[2][2]
    np.testing.assert_allclose((P - centre) @ normal, 0.0, atol=1e-12)
    diagonal = edge * np.sqrt(3.0)
    for p in P[1:]:
        corner = centre + 0.5 * edge * np.sign(p - centre)
        assert np.linalg.norm(corner - p) == pytest.approx(0.1 * diagonal)
    rises = 0 if plane[1] == "x" else 1
    ahead = (P[1:, rises] - centre[rises]) * (1 if plane[0] == "+" else -1)
    np.testing.assert_allclose(ahead, P[1:, 2] - centre[2])
    nine = np.vstack([P, other_corners(centre, edge, plane)])
    assert len(np.unique(np.round(nine, 9), axis=0)) == 9
    assert np.linalg.matrix_rank(nine - centre) == 3


def test_drift_is_told_from_noise() -> None:
    rng = np.random.default_rng(3)
    still = [2e-5 * rng.normal(size=(30, 3)) for _ in range(5)]
    creeping = [p + np.linspace(0, 1, 30)[:, None] * np.array([0.0, 6e-5, 0.0]) for p in still]
    quiet, moved = drift(still), drift(creeping)
    assert quiet is not None
    assert moved is not None
    assert not quiet.beyond_noise
    assert moved.beyond_noise
    assert moved.shift[1] == pytest.approx(4e-5, abs=4 * moved.sigma_m)
    assert drift([p[:5] for p in still]) is None


# -- the data set


T_BASE_TRACKER = RigidTransform.from_components([-2.0, 1.0, 1.2], Rotation.from_rotvec([0.1, -0.2, 0.7]))
POINT = [0.05, -0.02, 0.08]


def data_set(
    off: dict[str, Array] | None = None,
    cycles: int = 30,
    noise: float = 0.0,
    scatter: float = 0.0,
    **keys: Any,
) -> dict[str, Any]:
    """Arrivals at nine poses of a cube; ``off`` is how far each is from where it was wanted, m."""
    rng = np.random.default_rng(5)
    centre, R = np.array([0.4, 0.2, 0.7]), Rotation.from_rotvec([2.9, 0.3, 0.1])
    places = {f"R{k}": p for k, p in enumerate(other_corners(centre, 0.4, "+x"), 1)}
    places |= {f"P{k}": p for k, p in enumerate(five_places(centre, 0.4, "+x"), 1)}
    samples = []
    for cycle in range(cycles + 1):
        for name, p in places.items():
            if (cycle == 0) is not name.startswith("R"):
                continue
            at = p + (off or {}).get(name, np.zeros(3)) + scatter * rng.normal(size=3)
            read = T_BASE_TRACKER.inv().apply(at) + noise * rng.normal(size=3)
            samples.append({"pose": name, "cycle": cycle, "p_tracker": read.tolist()})
    poses = [
        {
            "name": name,
            "T_base_flange": to_pose6(RigidTransform.from_components(p - R.apply(POINT), R)).tolist(),
            "q": [0.0] * 6,
        }
        for name, p in places.items()
    ]
    whole: dict[str, Any] = {
        "schema": "cellward.iso9283/1",
        "reflector": "smr1",
        "point": POINT,
        "noise": {"sigma0": 15e-6, "sigma_per_m": 6e-6},
        "payload_kg": 0.8,
        "speed_share": 1.0,
        "corrected": False,
        "registration": "fit",
        "kinematics": None,
        "cycles": cycles,
        "poses": poses,
        "samples": samples,
    }
    return whole | keys


def solved(folder: Path, data: dict[str, Any], **limits: float) -> dict[str, Any]:
    path = folder / "iso9283.json"
    path.write_text(json.dumps(data))
    return solve_iso9283(path, limits)


def known(data: dict[str, Any]) -> dict[str, Any]:
    """The same with the tracker's place from a calibration."""
    kinematics = {"version": 3, "T_base_tracker": to_pose6(T_BASE_TRACKER).tolist()}
    return data | {"registration": "kinematics", "kinematics": kinematics}


def test_rotations_of_a_six_degree_target_are_counted_and_judge_nothing(tmp_path: Path) -> None:
    data = known(data_set(cycles=2))
    plain = solved(tmp_path, data)
    data["samples"][-1]["rotation"] = [0.1, 0.2, 0.3]
    result = solved(tmp_path, data)
    assert result["inputs"]["rotations"] == 1
    assert result["result"] == plain["result"]


def test_with_a_known_place_AP_and_RP_are_the_true_ones(tmp_path: Path) -> None:
    off = {f"P{k}": np.array([0.0, 0.0, 1e-3 * k]) for k in range(1, 6)}
    result = solved(tmp_path, known(data_set(off, scatter=1e-4)))
    answer = result["result"]
    for k in range(1, 6):
        assert answer["AP"][f"P{k}"] == pytest.approx(1e-3 * k, abs=8e-5)
        assert answer["RP"][f"P{k}"] == pytest.approx(3.616e-4, rel=0.35)
    assert answer["AP_max"] == answer["AP"]["P5"]
    assert answer["kinematics_version"] == 3
    assert answer["formula"]["RP"].startswith("RP = mean(l) + 3 S_l")


def test_a_fitted_place_takes_up_a_common_error_and_says_so(tmp_path: Path) -> None:
    names = [*(f"R{k}" for k in range(1, 5)), *(f"P{k}" for k in range(1, 6))]
    common = {name: np.array([0.002, 0.0, 0.0]) for name in names}
    fitted = solved(tmp_path, data_set(common))
    assert max(p["AP_measured"] for p in fitted["result"]["poses"]) < 1e-9
    assert any("a common shift or turn" in words for words in fitted["observability"]["undetermined"])
    absolute = solved(tmp_path, known(data_set(common)))
    assert absolute["result"]["AP"]["P1"] == pytest.approx(0.002)
    assert [w["code"] for w in absolute["warnings"]][-1] == "iso9283.stand"


def test_no_figure_is_below_the_trackers_own(tmp_path: Path) -> None:
    result = solved(tmp_path, data_set(noise=3e-5))
    answer = result["result"]
    for pose in answer["poses"]:
        assert pose["AP"] >= pose["AP_tracker"] > pose["AP_measured"]
        assert pose["RP"] >= pose["RP_tracker"]
        sigma = 15e-6 + 6e-6 * np.linalg.norm(T_BASE_TRACKER.inv().apply(pose["commanded"]))
        assert pose["RP_tracker"] == pytest.approx(3.616 * sigma, rel=1e-3)
        assert pose["AP_tracker"] == pytest.approx(2.795 * sigma, rel=1e-3)
    assert "iso9283.not-resolved" in [w["code"] for w in result["warnings"]]


def test_limits_fail_the_test_and_name_the_poses(tmp_path: Path) -> None:
    data = known(data_set({"P4": np.array([0.0, 0.0015, 0.0])}, scatter=1e-4))
    failed = solved(tmp_path, data, max_AP_m=0.001, max_RP_m=0.001)
    assert failed["verdict"] == "fail"
    assert failed["reasons"][0].startswith("max_AP_m: AP is P4 1.5")
    assert failed["result"] is not None
    assert solved(tmp_path, data, max_AP_m=0.002)["verdict"] == "warn"  # AP of the others is not resolved


def test_few_cycles_are_told_and_fewer_than_two_refused(tmp_path: Path) -> None:
    result = solved(tmp_path, data_set(cycles=4))
    assert "4 cycles were measured; the standard has 30" in result["reasons"]
    with pytest.raises(CellError, match=r"P1 has 1, .* arrivals; two are the least"):
        solved(tmp_path, data_set(cycles=1) | {"cycles": 2})


def test_arrivals_that_are_missing_are_counted(tmp_path: Path) -> None:
    data = data_set(cycles=10)
    data["samples"] = [s for s in data["samples"] if s["pose"] != "P2" or s["cycle"] < 3]
    result = solved(tmp_path, data)
    assert result["result"]["poses"][1]["cycles"] == 2
    assert "42 of 50 arrivals could be measured" in result["reasons"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"samples": [{"pose": "P9", "cycle": 1, "p_tracker": [1, 2, 3]}]}, "'P9' is not among the poses"),
        ({"registration": "kinematics"}, "T_base_tracker of the kinematics is missing"),
        ({"speed_share": 0}, "speed_share"),
    ],
)
def test_a_wrong_data_set_is_refused_with_its_field(
    tmp_path: Path, change: dict[str, Any], told: str
) -> None:
    with pytest.raises(CellError, match=told):
        solved(tmp_path, data_set(cycles=2) | change)
