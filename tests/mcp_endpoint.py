# SPDX-License-Identifier: Apache-2.0
"""The MCP server over HTTP, for tests, in this process."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from lithe.mcp.http import Endpoint
from lithe.mcp.server import Server


@contextmanager
def serving(server: Server, token: str) -> Iterator[Endpoint]:
    """On a free port, until the end of `with`."""
    made = Endpoint(server, 0, token)
    thread = threading.Thread(target=made.serve_forever)
    thread.start()
    yield made
    made.shutdown()
    thread.join()
    made.server_close()
