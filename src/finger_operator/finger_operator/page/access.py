"""Who may open the page and command the rig."""

from __future__ import annotations

import hmac
import ipaddress
from collections.abc import Collection
from typing import Any
from urllib.parse import urlsplit


def is_loopback(address: str | None) -> bool:
    """Whether a peer's address is this machine."""
    try:
        peer = ipaddress.ip_address((address or "").split("%")[0])
    except ValueError:
        return False
    mapped = getattr(peer, "ipv4_mapped", None)
    return (mapped or peer).is_loopback


def host_allowed(header: str | None, host: str, port: int, further: Collection[str]) -> bool:
    """Whether a Host header names this server: by address, as localhost, or by a `further` name."""
    try:
        parts = urlsplit(f"//{header or ''}")
        name, given_port = parts.hostname or "", parts.port or 80
    except ValueError:
        return False
    if not name:
        return False
    if name in further:
        return True
    if given_port != port:
        return False
    if name in ("localhost", host):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def same_secret(given: Any, token: str) -> bool:
    """Whether a browser's token is the right one, compared in constant time."""
    return isinstance(given, str) and hmac.compare_digest(given.encode(), token.encode())
