"""Moved to judge."""

from leanboom.judge import *  # noqa: F403
