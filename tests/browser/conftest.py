"""What is expected of a page is waited for as long as a busy machine may need."""

from __future__ import annotations

from playwright.sync_api import expect

expect.set_options(timeout=60_000.0)
