# SPDX-License-Identifier: Apache-2.0
"""`python -m bench.swap`, which `make bench-swap` runs."""

import sys

import lithe  # noqa: F401  (before numpy, whose threads it limits)

from bench.swap.run import main

sys.exit(main(sys.argv[1:]))
