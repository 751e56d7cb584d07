"""Health check of the console in its container: `python -m mazebot.console.health`."""

from __future__ import annotations

import http.client
import sys

PORT = 8080
_PATIENCE_S = 3.0


def is_healthy(port: int) -> bool:
    """Whether the console answers on this machine."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=_PATIENCE_S)
    try:
        connection.request("GET", "/healthz")
        return connection.getresponse().status == http.HTTPStatus.OK
    except (OSError, http.client.HTTPException):
        return False
    finally:
        connection.close()


if __name__ == "__main__":
    sys.exit(not is_healthy(PORT))
