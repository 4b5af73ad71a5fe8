# SPDX-License-Identifier: Apache-2.0
"""LITHE for the Brain: read the Spine's data, publish plans, replace its control law while the robot moves.

import lithe
robot = lithe.connect()
robot.swap("laws/gravity_pd.cpp", params={"mgl_nm": 0.165})
robot.go_to([1.0], in_s=0.5)
"""

from __future__ import annotations

from . import place

place.prepare()  # before numpy comes with the next lines

from .errors import BadPlan, LitheError, NoSupervisor, NotRunning, Refused, ShmError  # noqa: E402
from .remote import Remote  # noqa: E402
from .robot import Robot, connect  # noqa: E402

__all__ = ["BadPlan", "LitheError", "NoSupervisor", "NotRunning", "Refused", "Remote", "Robot", "ShmError", "connect"]
__version__ = "0.2.0.dev0"  # the one place: CMakeLists.txt and pyproject.toml read it here
