# SPDX-License-Identifier: Apache-2.0
"""Searches laws and their parameters on the simulated robot: `python -m lithe.evolve ROBOT.toml LAW.cpp ...`."""

from .evaluate import Candidate, Score, Unit, compile_laws, evaluate
from .search import Found, Plan, Search

__all__ = ["Candidate", "Found", "Plan", "Score", "Search", "Unit", "compile_laws", "evaluate"]
