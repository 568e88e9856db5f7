# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Calls of services in tests, safe against an answer that is dropped on a busy machine.

A client finds a service ready when it has discovered the server. The server may discover the
client later, and then drops its answer after 0.1 s ("client will not receive response"). What may
be asked twice is therefore asked again.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

PATIENCE = 5.0
"""s without an answer before a request is sent again."""


def answer(client: Any, request: Any, until: Callable[..., Any], *, repeat: bool = False) -> Any:
    """Response of a service; `until` spins until a condition holds, and fails in the end.

    repeat: whether the request may be sent twice.
    """
    until(client.service_is_ready)
    sent = [client.call_async(request)]
    since = time.monotonic()

    def answered() -> bool:
        nonlocal since
        if repeat and time.monotonic() - since > PATIENCE:
            sent.append(client.call_async(request))
            since = time.monotonic()
        return any(future.done() for future in sent)

    until(answered)
    return next(future.result() for future in sent if future.done())


def call(node: Any, kind: Any, name: str, request: Any, until: Callable[..., Any]) -> Any:
    """Response of a service by a client that `node` has for this call only.

    Requests of parameters and of a lifecycle state are repeated without an answer.
    """
    client = node.create_client(kind, name)
    repeat = kind.__module__.startswith("rcl_interfaces.") or kind.__name__ == "GetState"
    try:
        return answer(client, request, until, repeat=repeat)
    finally:
        node.destroy_client(client)
