"""Measurements of time, memory and energy; printed, never asserted."""
