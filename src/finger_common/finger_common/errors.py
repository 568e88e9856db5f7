"""The error family of the suite.

FingerError
├── InputError    what the user gave cannot be used: files, values, arguments (exit code 2)
├── DeviceError   a device is missing, silent or sends wrong data
└── ModelError    a computation failed; names time and load

Every message is one sentence that names what is wrong, where, and what to change.
"""

from __future__ import annotations


class FingerError(Exception):
    """Base class of all errors raised on purpose by the suite."""


class InputError(FingerError):
    """A file, value or argument that cannot be used.

    Raised for: a missing or unreadable file, a wrong header, key, type or range, contradictory
    options.
    """


class DeviceError(FingerError):
    """A device that is absent, silent, misconfigured or reports a fault.

    Raised for: connection refused or lost, no reply within the deadline, an unexpected reply, a
    critical status.
    """


class ModelError(FingerError):
    """A computation that could not be carried out.

    Raised for: no convergence of a load step, a load the finger cannot carry; names time, force and
    cause.
    """
