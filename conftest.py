# SPDX-License-Identifier: Apache-2.0
"""What all tests have in common, wherever they lie."""

pytest_plugins = ["stolen_time"]
