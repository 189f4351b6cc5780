"""Checks of the MN400 on USB."""
