"""Who may talk to the viewer: requests are refused unless host, origin and token are right.

A page of any web site can send requests to 127.0.0.1, and by DNS rebinding even read the answers.
So a request must name this machine (Host), a page that sends one must be the viewer's own
(Origin), and each must bring the token, which only the printed address has.
"""

import hmac
import ipaddress
import re
import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

TOKEN = re.compile(r"[A-Za-z0-9_-]{16,128}")
LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
HOST = re.compile(r"(?P<name>[A-Za-z0-9.-]+|\[[0-9a-f:.]+\])(:(?P<port>[0-9]{1,5}))?")


@dataclass(frozen=True)
class Guard:
    """Checks of requests; the same for pages and websockets."""

    token: str
    host: str
    """That the server listens on."""
    port: int

    def __post_init__(self) -> None:
        """Refuse a token that could be guessed, or that an address cannot hold."""
        if not TOKEN.fullmatch(self.token):
            raise ValueError(
                "the token must be 16 to 128 letters, digits, '-' or '_', so that nobody guesses "
                f"it: got {len(self.token)} characters (leave it out to get a random one)"
            )

    @property
    def cookie(self) -> str:
        """Name of the cookie that holds the token; cookies are shared by all ports of a host."""
        return f"instok3d_{self.port}"

    @property
    def url(self) -> str:
        """The address that opens the viewer."""
        name = "127.0.0.1" if self.host in ("127.0.0.1", "0.0.0.0") else self.host
        shown = f"[{name}]" if ":" in name else name
        return f"http://{shown}:{self.port}/?token={self.token}"

    def refusal(self, target: str, header: Callable[[str], Sequence[str]]) -> str | None:
        """Why a request is refused; None where it is not.

        Args:
            target: The request's path and query.
            header: All values of a header by its name.
        """
        hosts, origins = header("Host"), header("Origin")
        host = HOST.fullmatch(hosts[0].lower()) if len(hosts) == 1 else None
        if host is None or not self._is_ours(host["name"]):
            return "this viewer is not known by that host name"
        # A browser sends Origin with every websocket; without one it is a page that was typed in.
        is_websocket = any("websocket" in value.lower() for value in header("Upgrade"))
        if is_websocket and len(origins) != 1:
            return "a websocket must say where its page came from"
        if any(origin.lower() != f"http://{hosts[0].lower()}" for origin in origins):
            return "the request came from a page of another site"
        if not self.has_token(target) and not self._has_cookie(header("Cookie")):
            return "the address must have the token that was printed when the viewer started"
        return None

    def has_token(self, target: str) -> bool:
        """Whether the query of an address has the token."""
        try:
            given = parse_qs(urlsplit(target).query, max_num_fields=16).get("token", [])
        except ValueError:  # too many fields, or no address at all
            return False
        return len(given) == 1 and self._is_token(given[0])

    def _has_cookie(self, values: Sequence[str]) -> bool:
        # By hand: http.cookies gives up at cookies of other ports that have JSON in them.
        pairs = [pair.strip().partition("=") for value in values for pair in value.split(";")]
        return any(name == self.cookie and self._is_token(given) for name, _, given in pairs)

    def _is_token(self, given: str) -> bool:
        # Headers that are not ASCII arrive with surrogates.
        return hmac.compare_digest(given.encode("utf-8", "surrogatepass"), self.token.encode())

    def _is_ours(self, name: str) -> bool:
        """Whether a host name can be this server's without a name server having said so.

        Rebinding needs a name that another's name server answers for; addresses have none.
        """
        if name in LOOPBACK or name == self.host.lower():
            return True
        return self.host not in LOOPBACK and _is_address(name.strip("[]"))


def random_token() -> str:
    """A token of 256 random bits."""
    return secrets.token_urlsafe(32)


def is_loopback(host: str) -> bool:
    """Whether an address reaches this machine from itself alone."""
    return host == "localhost" or (_is_address(host) and ipaddress.ip_address(host).is_loopback)


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True
