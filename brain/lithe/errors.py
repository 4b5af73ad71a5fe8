# SPDX-License-Identifier: Apache-2.0
"""The errors of this package: each says what is wrong, where, and the next step."""

from __future__ import annotations


class LitheError(Exception):
    """Base of all errors of this package."""


class NotRunning(LitheError):
    """There is no robot of that name, or its supervisor does not answer."""


class NoSupervisor(NotRunning):
    """No process listens at the robot's control socket; nothing was sent."""


class Refused(LitheError):
    """The robot refused the request.

    `code` is for programs (e.g. "refused_estop"), `next` is the next step; `detail` has further data of the refusal,
    such as a compiler's diagnostics.
    """

    def __init__(self, code: str, message: str, next_step: str = "", detail: dict[str, object] | None = None) -> None:
        super().__init__(f"{message}" + (f"\n  next: {next_step}" if next_step else ""))
        self.code = code
        self.message = message
        self.next = next_step
        self.detail = detail or {}


class ShmError(LitheError):
    """Shared memory cannot be used; the text says what, where and what to do next."""


class BadPlan(ShmError, ValueError):
    """A plan whose arrays do not fit together; nothing was published."""
