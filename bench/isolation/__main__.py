# SPDX-License-Identifier: Apache-2.0
"""`python -m bench.isolation`, which `make bench-isolation` runs."""

import sys

import lithe  # noqa: F401  (before numpy, whose threads it limits)

from bench.isolation.run import main

sys.exit(main(sys.argv[1:]))
