"""Waiting for what another thread or process does."""

import time

import pytest


def wait_for(condition, deadline_s=10.0, told=None):
    """What ``condition`` returns once it is true; fails with what ``told`` says if it never is."""
    deadline = time.monotonic() + deadline_s
    while time.monotonic() < deadline:
        value = condition()
        if value:
            return value
        time.sleep(0.01)
    return pytest.fail(told() if told else f"not within {deadline_s} s")
