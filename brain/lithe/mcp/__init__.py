# SPDX-License-Identifier: Apache-2.0
"""The robot as tools of the Model Context Protocol, over stdin and stdout: a client of the gateway.

python -m lithe.mcp                      serves; start it from your agent's configuration
python -m lithe.mcp allow --minutes 15   a person permits agents to move the robot, for that time
python -m lithe.mcp forbid               and takes it back
"""
