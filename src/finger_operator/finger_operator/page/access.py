# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Who may open the page and command the rig."""

from __future__ import annotations

import hmac
import ipaddress
from collections.abc import Collection, Mapping
from typing import Any
from urllib.parse import urlsplit

FORWARDING = ("Forwarded", "Via", "X-Forwarded-For", "X-Forwarded-Host", "X-Real-IP")
"""Headers that proxies add."""


def is_loopback(address: str | None) -> bool:
    """Whether a peer's address is this machine."""
    try:
        peer = ipaddress.ip_address((address or "").split("%")[0])
    except ValueError:
        return False
    mapped = getattr(peer, "ipv4_mapped", None)
    return (mapped or peer).is_loopback


def _named(header: str | None) -> tuple[str, int]:
    """Name and port in a Host header; an empty name for what is none."""
    try:
        parts = urlsplit(f"//{header or ''}")
        return parts.hostname or "", parts.port or 80
    except ValueError:
        return "", 0


def host_allowed(header: str | None, host: str, further: Collection[str]) -> bool:
    """Whether a Host header names this server: by address, as localhost, or by a `further` name.

    Any port: a forwarded one has another number. A foreign name that resolves to this machine is
    what must not pass.
    """
    name, _ = _named(header)
    if name and (name in further or name in ("localhost", host)):
        return True
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def from_this_machine(address: str | None, port: int, headers: Mapping[str, str]) -> bool:
    """Whether a request to our `port` was made on this machine, for this machine.

    A reverse proxy or a forwarded port makes requests from here for people elsewhere: it names
    another host or port, or says that it forwards. Only a port that is forwarded to the same number
    elsewhere looks like this machine; who can forward it may log in here.
    """
    name, given_port = _named(headers.get("Host"))
    forwarded = given_port != port or any(key in headers for key in FORWARDING)
    return is_loopback(address) and not forwarded and (name == "localhost" or is_loopback(name))


def same_secret(given: Any, token: str) -> bool:
    """Whether a browser's token is the right one, compared in constant time."""
    if not isinstance(given, str):
        return False
    # JSON may hold lone surrogates, which UTF-8 does not have.
    return hmac.compare_digest(given.encode(errors="surrogatepass"), token.encode())
