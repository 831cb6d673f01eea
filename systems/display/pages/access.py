"""The rule that decides which requests may see and steer a run."""

import secrets
from collections.abc import Iterable
from dataclasses import dataclass, field
from hmac import compare_digest
from ipaddress import ip_address
from socket import gethostname
from urllib.parse import urlsplit

_EVERYWHERE = ("", "*", "0.0.0.0", "::")  # Names of all addresses of this machine
_TOKEN = secrets.token_urlsafe(24)


@dataclass(frozen=True)
class Access:
    """Rule for requests to the pages of a run.

    A browser sends the requests of any open page to any server on this machine, and the name in
    such a page's address may be made to stand for this machine afterwards (DNS rebinding). A
    request is therefore answered only if

    - its Host header names this server, which is not so after DNS rebinding,
    - its Origin header, if it has one, names the same server. A WebSocket must have one, because
      browsers do not keep foreign pages from opening WebSockets;
    - it carries the token, which is drawn anew for each program.

    The Host's port is not checked, so that the pages can be reached through a tunnel.

    Parameters
    ----------
    host
        Name or address at which the server listens; ``*`` stands for all addresses of this machine.
    token
        Secret that every request must carry; by default the one of this program.

    Notes
    -----
    The rule guards against pages in a browser. It does not guard against other programs that run
    under the same user, nor against anyone who can read the traffic to a `host` that is not this
    machine: it is not encrypted. Browsers send cookies to every port of a host, so a user who opens
    another server's page under the same host name shows the token to that server.
    """

    host: str = "localhost"
    token: str = field(default=_TOKEN, repr=False)

    @property
    def listens_everywhere(self) -> bool:
        """True if the server listens at all addresses of this machine."""
        return self.host in _EVERYWHERE

    @property
    def public_name(self) -> str:
        """Host name for the addresses that are given to the user, in brackets if IPv6."""
        name = gethostname() if self.listens_everywhere else self.host
        return f"[{name}]" if ":" in name else name

    def refusal(
        self, host: str | None, origin: str | None, tokens: Iterable[str], *, websocket: bool
    ) -> str | None:
        """Return why a request with such headers and tokens is refused; None if it is not."""
        if host is None or not self._is_own(host):
            return "Its address does not name this server."
        foreign = origin is not None and origin.lower() != f"http://{host.lower()}"
        if foreign or (websocket and origin is None):
            return "It was sent by another page."
        wanted = self.token.encode()
        if not any(compare_digest(token.encode(), wanted) for token in tokens):
            return "It lacks the token of this run."
        return None

    def _is_own(self, host: str) -> bool:
        """Return True if a Host header names this server."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
            urlsplit(f"//{host}").port  # noqa: B018 - raises a ValueError if there is no such port
        except ValueError:
            return False
        if name in ("localhost", "127.0.0.1", "::1"):
            return True
        if not self.listens_everywhere:
            return name == self.host.lower().strip("[]")
        # DNS rebinding needs a name: an address in numbers stands for itself.
        return name == gethostname().lower() or _is_address(name)


def _is_address(name: str) -> bool:
    try:
        ip_address(name)
    except ValueError:
        return False
    return True
