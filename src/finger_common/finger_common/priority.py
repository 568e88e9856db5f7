# Copyright 2026 Finger contact maintainers
# SPDX-License-Identifier: Apache-2.0

"""Real-time priority of a process whose samples must not wait for other programs.

A process of the usual kind that wakes up waits, on a busy machine, until a running one has used up
its time: several milliseconds. One of SCHED_FIFO runs at once.
"""

from __future__ import annotations

import os

PRIORITY = 20
"""Of 1 to 99; below the kernel's own threads (50), whose work the samples need."""


def run_in_real_time(priority: int = PRIORITY) -> str:
    """Give all threads of this process, and those that they start, SCHED_FIFO.

    Returns why it cannot be, or "". Linux only; needs the right to it (`rtprio`, CAP_SYS_NICE).
    """
    try:
        for thread in os.listdir("/proc/self/task"):
            os.sched_setscheduler(int(thread), os.SCHED_FIFO, os.sched_param(priority))
    except ProcessLookupError:
        # One ended meanwhile; each of the others is asked again.
        return run_in_real_time(priority)
    except PermissionError:
        return "no right to real-time priority (rtprio in /etc/security/limits.conf gives it)"
    except (AttributeError, OSError) as error:
        return f"this system gives no real-time priority ({error})"
    return ""
