"""Where the priors of a lens and of a target are said to come from."""

import pytest

from procedures.hand_eye.known_parts import known_lens, known_parts


@pytest.mark.parametrize(
    ("sigma", "source"),
    [
        (
            None,
            "default: a camera that its maker has calibrated (focal length 0.3 %, principal point 5 px)",
        ),
        ({"f": 1e-3, "c_px": None}, "camera.sigma.f (focal length 0.1 %); default: principal point 5 px"),
        ({"c_px": 2.0}, "camera.sigma.c_px (principal point 2 px); default: focal length 0.3 %"),
        ({"f": 1e-3, "c_px": 2.0}, "camera.sigma (focal length 0.1 %, principal point 2 px)"),
    ],
)
def test_a_lens_of_which_one_figure_is_stated_has_the_other_by_default(
    sigma: dict[str, float] | None, source: str
) -> None:
    assert known_lens(sigma)[1] == source


@pytest.mark.parametrize(
    ("stated", "source"),
    [
        ({}, "default: one sheet from an office printer (printed size 0.2 %, flat to 0.2 mm)"),
        ({"scale_sigma": 1e-4}, "target.scale_sigma (printed size 0.01 %); default: flat to 0.2 mm"),
        ({"flatness_m": 1e-4}, "target.flatness_m (flat to 0.1 mm); default: printed size 0.2 %"),
        (
            {"scale_sigma": 1e-4, "flatness_m": 1e-4},
            "target.scale_sigma and target.flatness_m (printed size 0.01 %, flat to 0.1 mm)",
        ),
    ],
)
def test_a_target_of_which_one_figure_is_stated_has_the_other_by_default(
    stated: dict[str, float], source: str
) -> None:
    assert known_parts(stated, None, None).sources["target"] == source
