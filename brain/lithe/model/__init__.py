# SPDX-License-Identifier: Apache-2.0
"""The guard's model of a robot's links, from a URDF or MJCF file."""

from .links import Link, links_of, with_links

__all__ = ["Link", "links_of", "with_links"]
