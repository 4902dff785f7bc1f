"""Who may do what on the operator's page, and what other sites' pages cannot make a browser do."""

from typing import Any

import pytest

from daemon.requests import WRITES
from daemon.web.sessions import Sessions
from daemon.web.tokens import LETTERS, digest, new_token
from daemon.web.writing import NEEDS
from tests.kit.page_rig import ROLES, TOKENS, PageRig, http_section, on_page

PARAMS: dict[str, dict[str, Any]] = {
    "start": {"job": "laser-check"},
    "confirm": {"prompt_id": 65537},
    "skip": {"prompt_id": 65537},
    "accept": {"result_id": 4},
    "reject": {"result_id": 5, "why": "the board was loose"},
    "rollback": {"name": "T_flange_camera"},
    "sign": {"run_id": 3, "name": "E. Muster", "role": "checked", "remark": "", "digest": "00"},
}


def test_the_page_can_ask_for_what_the_control_socket_takes_and_each_needs_a_role() -> None:
    assert NEEDS.keys() == WRITES.keys()


def test_without_a_login_nothing_can_be_written_and_each_attempt_is_audited() -> None:
    async def use(subject: PageRig) -> None:
        for method in WRITES:
            status, answer = await subject.post(f"/api/do/{method}", PARAMS.get(method))
            assert (status, answer["error"]["name"]) == (401, "LOGIN_NEEDED"), method
        assert subject.engine.asked == []

    left = on_page(use, look_without_login=True)
    assert sorted((what, accepted) for _, what, accepted, _ in left.audited) == [
        (method, False) for method in sorted(WRITES)
    ]


@pytest.mark.parametrize(
    "changed",
    [
        {"Origin": "http://evil.example"},
        {"Origin": None},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site"},
        {"Sec_Fetch_Site": "same-site"},
        {"Content_Type": "text/plain"},
        {"Content_Type": "application/x-www-form-urlencoded"},
        {"X_Cellward_Csrf": None},
        {"X_Cellward_Csrf": "guessed"},
        {"Host": "evil.example"},
    ],
)
def test_another_sites_page_starts_no_job_in_the_browser_of_somebody_who_is_logged_in(
    changed: dict[str, str | None],
) -> None:
    async def use(subject: PageRig) -> None:
        await subject.login("ida")
        status, answer = await subject.post("/api/do/start", PARAMS["start"], **changed)
        assert (status, answer["error"]["name"]) == (403, "PAGE_REFUSED")
        assert subject.engine.asked == []

    left = on_page(use)
    assert [accepted for _, what, accepted, _ in left.audited if "start" in what] == [False]


def test_each_role_does_what_it_may_and_the_engine_is_told_who_asked() -> None:
    async def use(subject: PageRig) -> None:
        for name, role in ROLES.items():
            assert (await subject.login(name))[1]["role"] == role
            for method, needed in NEEDS.items():
                if method == "acknowledge_ledger":  # the stand-in has no ledger
                    continue
                allowed = list(ROLES.values()).index(needed) <= list(ROLES.values()).index(role)
                before = len(subject.engine.asked)
                status, answer = await subject.post(f"/api/do/{method}", PARAMS.get(method))
                assert status == (200 if allowed else 403), (name, method, answer)
                if not allowed:
                    assert answer["error"]["name"] == "ROLE_TOO_LOW"
                    assert len(subject.engine.asked) == before
        request = next(what for verb, what, *_ in subject.engine.asked if verb == "start")
        assert (request.who, request.channel) == ("otto (page, 127.0.0.1)", "web")

    left = on_page(use)
    assert ("vera (page, 127.0.0.1)", "halt", True, "") in left.audited


def test_a_result_with_warnings_is_accepted_by_an_integrator_with_a_reason() -> None:
    async def use(subject: PageRig) -> None:
        warned = {"result_id": 4, "warned": True}
        await subject.login("otto")
        assert (await subject.post("/api/do/accept", {**warned, "why": "seen"}))[0] == 403
        await subject.login("ida")
        status, answer = await subject.post("/api/do/accept", {**warned, "why": "  "})
        assert status == 400
        assert "'why' gives the reason" in answer["error"]["text"]
        assert (await subject.post("/api/do/accept", {**warned, "why": "the scale was measured"}))[0] == 200

    on_page(use)


def test_the_cookie_of_a_login_is_kept_from_scripts_and_from_other_sites() -> None:
    async def use(subject: PageRig) -> None:
        async with subject.client.post(
            f"{subject.origin}/api/login",
            json={"token": TOKENS["otto"]},
            headers={"Origin": subject.origin},
        ) as answer:
            cookie = answer.headers["Set-Cookie"]
        assert "HttpOnly" in cookie
        assert "SameSite=Strict" in cookie
        assert "Domain" not in cookie
        assert f"cellward-{subject.server.address[1]}=" in cookie
        assert TOKENS["otto"] not in cookie

    on_page(use)


def test_a_logout_ends_the_session_on_the_server() -> None:
    async def use(subject: PageRig) -> None:
        await subject.login("otto")
        kept = {cookie.key: cookie.value for cookie in subject.client.cookie_jar}
        assert (await subject.post("/api/logout"))[0] == 200
        subject.client.cookie_jar.update_cookies(kept)
        assert (await subject.post("/api/do/pause"))[0] == 401

    on_page(use)


def test_a_token_is_read_however_it_was_typed_and_guesses_are_refused() -> None:
    async def use(subject: PageRig) -> None:
        typed = TOKENS["otto"].lower().replace("-", " ").replace("1", "l")
        assert (await subject.post("/api/login", {"token": typed}))[1]["user"] == "otto"
        for _ in range(5):
            status, answer = await subject.post("/api/login", {"token": "0000-0000-0000-0000"})
            assert (status, answer["error"]["name"]) == (401, "LOGIN_REFUSED")
        status, answer = await subject.login("otto")
        assert (status, answer["error"]["name"]) == (429, "LOGIN_TOO_OFTEN")

    left = on_page(use)
    assert [what for _, what, accepted, _ in left.audited if not accepted] == ["login"] * 6


def test_after_a_minute_the_right_token_is_taken_again_and_other_addresses_never_waited() -> None:
    now = [0.0]
    subject = Sessions(http_section().user, 100.0, lambda: now[0])
    for _ in range(5):
        with pytest.raises(Exception, match="not known"):
            subject.login("guess", "10.0.0.1")
    with pytest.raises(Exception, match="Too many"):
        subject.login(TOKENS["otto"], "10.0.0.1")
    subject.login(TOKENS["otto"], "10.0.0.2")
    now[0] = 61.0
    assert subject.login(TOKENS["otto"], "10.0.0.1")[1].user == "otto"


def test_a_session_in_which_nothing_is_done_ends_and_one_in_use_goes_on() -> None:
    now = [0.0]
    subject = Sessions(http_section().user, 100.0, lambda: now[0])
    idle, used = (subject.login(TOKENS[name], "10.0.0.1") for name in ("vera", "otto"))
    now[0] = 90.0
    subject.use(used[1])
    now[0] = 150.0
    assert subject.find(idle[0]) is None
    assert subject.find(used[0]) is used[1]
    assert subject.find(None) is None
    assert subject.find("no cookie of ours") is None


def test_many_logins_cost_the_oldest_ones_and_never_memory_without_bound(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("daemon.web.sessions.MAX_SESSIONS", 3)
    subject = Sessions(http_section().user, 100.0, lambda: 0.0)
    cookies = [subject.login(TOKENS["otto"], "10.0.0.1")[0] for _ in range(5)]
    assert [subject.find(cookie) is not None for cookie in cookies] == [False, False, True, True, True]


def test_tokens_differ_and_have_eighty_bits() -> None:
    made = {new_token() for _ in range(50)}
    assert len(made) == 50
    assert all(len(token.replace("-", "")) == 16 and set(token) <= {*LETTERS, "-"} for token in made)
    assert len({digest(token) for token in made}) == 50
