import re

import pytest

from instok3d.viewer.guard import Guard, is_loopback, random_token

TOKEN = "abcdefghijklmnopqrstuvwxyz012345"
COOKIE = {"Cookie": f"instok3d_8080={TOKEN}"}


def refusal(target: str = "/", host: str = "127.0.0.1", **headers: str | list[str]) -> str | None:
    given = {"Host": "127.0.0.1:8080"} | headers
    values = {name: [value] if isinstance(value, str) else value for name, value in given.items()}
    return Guard(TOKEN, host, 8080).refusal(target, lambda name: values.get(name, []))


def test_the_token_lets_in_by_address_or_by_cookie():
    assert refusal(f"/?token={TOKEN}") is None
    assert refusal(**COOKIE) is None
    assert refusal(Cookie=f"a=b; instok3d_8080={TOKEN}; c=d") is None


def test_cookies_of_other_programs_on_this_machine_do_no_harm():
    others = '_xsrf="2|a\\"; layout={"x": [1, 2]}; =; é\udcff'
    assert refusal(Cookie=f"{others}; instok3d_8080={TOKEN}") is None
    assert refusal(Cookie=[others, f"instok3d_8080={TOKEN}"]) is None
    assert refusal(Cookie=others) is not None


@pytest.mark.parametrize(
    ("target", "cookie"),
    [
        ("/", ""),
        ("/?token=", ""),
        (f"/?token={TOKEN[:-1]}", ""),
        (f"/?token={TOKEN}&token=x", ""),
        (f"/token={TOKEN}", ""),
        ("/", f"instok3d_8081={TOKEN}"),
        ("/", f"instok3d_8080={TOKEN}0"),
        ("/", 'instok3d_8080="'),
        ("/", "\x00=;;;==,"),
        ("/?token=\u00e9", ""),
        ("/?token=\udcff", "instok3d_8080=\udcff"),
        ("/?" + "&".join(f"a{n}=1" for n in range(99)) + f"&token={TOKEN}", ""),
        ("//[", ""),
    ],
)
def test_without_the_token_nobody_gets_in(target: str, cookie: str):
    reason = refusal(target, Cookie=cookie)
    assert reason is not None
    assert "token" in reason


@pytest.mark.parametrize("name", ["127.0.0.1:8080", "localhost:9000", "LOCALHOST", "[::1]:8080"])
def test_this_machine_is_known_by_its_own_names_at_any_port_of_a_tunnel(name: str):
    assert refusal(Host=name, **COOKIE) is None


@pytest.mark.parametrize(
    "name",
    ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "127.0.0.1@evil.example", "",
     "127.0.0.1:8080/", "192.168.0.7:8080", "localhost.:8080", "127.0.0.1:8080;x"],
)  # fmt: skip
def test_names_that_a_name_server_could_answer_for_are_refused(name: str):
    assert refusal(Host=name, **COOKIE) == "this viewer is not known by that host name"


def test_a_request_without_a_host_or_with_two_is_refused():
    assert refusal(Host=[], **COOKIE) is not None
    assert refusal(Host=["127.0.0.1:8080", "127.0.0.1:8080"], **COOKIE) is not None


@pytest.mark.parametrize(
    "origin",
    ["http://evil.example", "https://127.0.0.1:8080", "http://127.0.0.1:8081", "null", "",
     "http://127.0.0.1:8080.evil.example", "http://localhost:8080"],
)  # fmt: skip
def test_pages_of_other_sites_are_refused_whatever_they_bring(origin: str):
    for more in ({}, {"Upgrade": "websocket"}):
        reason = refusal(f"/?token={TOKEN}", Origin=origin, **COOKIE, **more)
        assert reason == "the request came from a page of another site"


def test_a_websocket_comes_from_our_page_alone():
    assert refusal(Upgrade="websocket", Origin="http://127.0.0.1:8080", **COOKIE) is None
    for upgrade in ("websocket", "WebSocket", "x, websocket"):
        assert refusal(Upgrade=upgrade, **COOKIE) is not None


def test_on_the_network_addresses_and_the_given_name_are_known():
    assert refusal(host="0.0.0.0", Host="192.168.0.7:8080", **COOKIE) is None
    assert refusal(host="0.0.0.0", Host="evil.example:8080", **COOKIE) is not None
    assert refusal(host="box.lan", Host="box.lan:8080", **COOKIE) is None
    assert refusal(host="box.lan", Host="other.lan:8080", **COOKIE) is not None


def test_random_tokens_are_long_and_never_the_same():
    tokens = {random_token() for _ in range(50)}
    assert len(tokens) == 50
    assert all(len(token) == 43 for token in tokens)
    assert all(Guard(token, "127.0.0.1", 1).has_token(f"/?token={token}") for token in tokens)


@pytest.mark.parametrize(
    "token", ["", "short", "x" * 129, "x" * 20 + "&", "x" * 20 + "\n", "é" * 20]
)
def test_tokens_that_could_be_guessed_or_not_be_written_are_refused(token: str):
    with pytest.raises(ValueError, match=re.escape("16 to 128 letters, digits, '-' or '_'")):
        Guard(token, "127.0.0.1", 8080)


def test_the_address_names_a_place_that_can_be_opened():
    assert Guard(TOKEN, "0.0.0.0", 8080).url == f"http://127.0.0.1:8080/?token={TOKEN}"
    assert Guard(TOKEN, "::1", 8080).url == f"http://[::1]:8080/?token={TOKEN}"


def test_loopback_is_known():
    assert all(is_loopback(host) for host in ("127.0.0.1", "127.3.0.9", "::1", "localhost"))
    assert not any(is_loopback(host) for host in ("0.0.0.0", "::", "192.168.0.7", "box.lan", ""))
