# SPDX-License-Identifier: Apache-2.0
"""An agent with a language model: measures, identifies, asks the model for a law, swaps it, compares, keeps the best.

`python -m lithe.agent --url URL --model NAME`; see docs/agents.md.
"""
