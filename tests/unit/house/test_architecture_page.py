"""The picture of the architecture says what the import contracts allow."""

from daemon.docs.architecture import arrows


def test_layers_give_arrows_downwards_without_those_that_follow_from_others() -> None:
    contracts = [{"type": "layers", "layers": ["top", "left : right", "bottom"]}]
    subject = arrows(["bottom", "left", "right", "top"], contracts)
    assert subject == [("left", "bottom"), ("right", "bottom"), ("top", "left"), ("top", "right")]


def test_what_a_contract_forbids_has_no_arrow() -> None:
    contracts = [
        {"type": "layers", "layers": ["top", "middle", "bottom"]},
        {"type": "forbidden", "source_modules": ["top"], "forbidden_modules": ["middle"]},
    ]
    assert arrows(["bottom", "middle", "top"], contracts) == [("middle", "bottom"), ("top", "bottom")]


def test_a_package_outside_the_layers_is_imported_by_none_of_them() -> None:
    contracts = [
        {"type": "layers", "layers": ["top", "bottom"]},
        {"type": "forbidden", "source_modules": ["beside"], "forbidden_modules": ["top"]},
    ]
    assert arrows(["beside", "bottom", "top"], contracts) == [("beside", "bottom"), ("top", "bottom")]
