# SPDX-License-Identifier: Apache-2.0
"""The soak: hours of random actions and faults on one robot, with invariants checked all the time."""
