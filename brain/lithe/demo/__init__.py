# SPDX-License-Identifier: Apache-2.0
"""The supervised-evolution experiment: a Brain, an agent that writes laws, and a judge. `python -m lithe.demo`."""
