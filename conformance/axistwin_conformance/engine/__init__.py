"""Runs a plan safely against a device and concludes verdicts."""
